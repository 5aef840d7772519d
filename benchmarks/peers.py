"""Processes that benchmarks start and with which they exchange lines of JSON.

`python -m benchmarks.peers MODULE ROLE ARGUMENT ...` runs one. The module `peers` has a router, a node that
answers scan requests, and a planner that waits for a step.
"""

from __future__ import annotations

import dataclasses
import importlib
import json
import os
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

import transport
from testbed.terrain_message import make_terrain

ROOT = Path(__file__).resolve().parents[1]
SHAPE = (108, 90)
PATIENCE = 60.0


class Peer:
    """A process with which lines of JSON are exchanged."""

    def __init__(self, command: list[str], *, cwd: Path = ROOT, **environment: str) -> None:
        """Start it and wait for its first line, which says that it is ready.

        Args:
            command: its command line.
            cwd: its working directory.
            environment: further variables of its environment.
        """
        self.popen = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            cwd=cwd,
            env={**os.environ, **environment},
        )
        self.hear()

    def tell(self, **command: Any) -> None:
        """Send a command."""
        assert self.popen.stdin is not None
        self.popen.stdin.write(json.dumps(command) + "\n")
        self.popen.stdin.flush()

    def hear(self) -> dict[str, Any]:
        """Read the next line; empty after the end of the process."""
        assert self.popen.stdout is not None
        return dict(json.loads(self.popen.stdout.readline() or "{}"))

    def end(self) -> None:
        """Kill it."""
        self.popen.kill()
        self.popen.wait()


def peer_command(module: str, *arguments: str) -> list[str]:
    """Command line of a peer: the function `run_ROLE` of a module of `benchmarks`; its role is the first argument."""
    return [sys.executable, "-m", "benchmarks.peers", module, *arguments]


@contextmanager
def peers() -> Iterator[Callable[..., Peer]]:
    """A function that starts processes; all of them are killed at the end."""
    started: list[Peer] = []

    def start(*arguments: str, module: str = "peers") -> Peer:
        started.append(Peer(peer_command(module, *arguments)))
        return started[-1]

    try:
        yield start
    finally:
        for peer in started:
            peer.end()


def free_port() -> int:
    """Free TCP port of this machine."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def free_endpoint() -> str:
    """Free Zenoh endpoint of this machine."""
    return f"tcp/127.0.0.1:{free_port()}"


def is_whole(terrain: transport.TerrainMessage, value: int) -> bool:
    """True if every cell of `variance` has this value."""
    return bool(np.all(terrain.layers["variance"] == value))


class Pauses:
    """Pauses of a simulated node: a footprint's grid, what is derived from it, and a map, all with values of 1."""

    def __init__(self, map_shape: tuple[int, int]) -> None:
        """Make both grids."""
        self._footprint, self._map = make_terrain(1), make_terrain(1, shape=map_shape, extent="map")
        self._occupancy = np.zeros(SHAPE, np.int8)
        self.sizes = {each.extent: len(transport.encode_terrain(each)) for each in (self._footprint, self._map)}

    def publish(self, server: transport.PerceptionServer) -> transport.TerrainMessage:
        """Publish one pause; return the message of the footprint."""
        number = server.next_sequence("footprint")
        changes: dict[str, Any] = {"robot": server.robot, "sequence": number, "step": number}
        made = []
        for grid, occupancy in ((self._footprint, self._occupancy), (self._map, None)):
            now = time.time_ns()
            made.append(dataclasses.replace(grid, stamp=now, scan_start=now, scan_end=now, **changes))
            server.publish(made[-1], occupancy=occupancy)
        return made[0]


def say(**reply: Any) -> None:
    """Send a line of JSON to the benchmark."""
    print(json.dumps(reply), flush=True)


def ended() -> threading.Event:
    """Event that is set when the standard input is closed."""
    event = threading.Event()

    def listen() -> None:
        sys.stdin.read()
        event.set()

    threading.Thread(target=listen, daemon=True).start()
    return event


def run_router(endpoint: str) -> None:
    """A Zenoh router and nothing else."""
    with transport.open_node(listen=endpoint):
        say(ready=True)
        sys.stdin.read()


def run_scanner(endpoint: str, mode: str, rows: str, columns: str, security: str = "") -> None:
    """A node that answers scan requests with grids of both extents, the map of this shape."""
    options: dict[str, Any] = {mode: endpoint, "timeout": PATIENCE, "security": security or None}
    pauses = Pauses((int(rows), int(columns)))
    with transport.open_node(**options) as session:
        server = transport.PerceptionServer(session)
        server.serve_scans(lambda _: pauses.publish(server))
        say(ready=True)
        sys.stdin.read()


def run_waiter(endpoint: str) -> None:
    """A planner that waits for the pause of each {"step": n} by `gp.TerrainClient`; reports when it had its grid."""
    import guara_perception as gp

    with gp.TerrainClient(endpoint, timeout=2 * PATIENCE) as client:
        say(ready=True)
        for line in sys.stdin:
            client.wait_for_step(json.loads(line)["step"], timeout=2 * PATIENCE)
            say(at=time.monotonic())


if __name__ == "__main__":
    name, role, *given = sys.argv[1:]
    getattr(importlib.import_module(f"benchmarks.{name}"), f"run_{role}")(*given)
