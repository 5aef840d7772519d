"""Processes that a benchmark starts, and the lines of JSON between them."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any


class Peer:
    """A process of a module of this package."""

    def __init__(self, *arguments: str, module: str = "transport_peer") -> None:
        """Start it and wait for its first line, which says that it is ready.

        Args:
            arguments: arguments of its command line.
            module: name of a module of `benchmarks`.
        """
        command = [sys.executable, "-m", f"benchmarks.{module}", *arguments]
        root = str(Path(__file__).resolve().parents[1])
        self.popen = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=root, env=dict(os.environ)
        )
        self.hear()

    def tell(self, **command: Any) -> None:
        """Give it a command."""
        assert self.popen.stdin is not None
        self.popen.stdin.write(json.dumps(command) + "\n")
        self.popen.stdin.flush()

    def hear(self) -> dict[str, Any]:
        """Its next line."""
        assert self.popen.stdout is not None
        return dict(json.loads(self.popen.stdout.readline() or "{}"))

    def end(self) -> None:
        """Kill it."""
        self.popen.kill()
        self.popen.wait()


@contextmanager
def peers() -> Iterator[Callable[..., Peer]]:
    """A function that starts processes; all of them are killed at the end."""
    started: list[Peer] = []

    def start(*arguments: str, module: str = "transport_peer") -> Peer:
        started.append(Peer(*arguments, module=module))
        return started[-1]

    try:
        yield start
    finally:
        for peer in started:
            peer.end()


def free_port() -> int:
    """A port of this machine that nobody uses."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def free_endpoint() -> str:
    """A Zenoh endpoint of this machine that nobody uses."""
    return f"tcp/127.0.0.1:{free_port()}"
