"""Fixtures of the transport's tests: free endpoints, other processes, and the message that they exchange."""

import importlib.util
import queue
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from testbed.slow_link import SlowLink
from tests.forked import ForkedProcess
from tests.ports import free_endpoint

PEER = Path(__file__).with_name("peer.py")
PATIENCE = 180.0
"""[s] For anything that must happen at all; generous, because the machine may be loaded."""


def _load_peer():
    specification = importlib.util.spec_from_file_location("transport_test_peer", PEER)
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


@pytest.fixture(scope="session")
def peer():
    """The module of the other processes, with `make_terrain` and `is_whole`."""
    return _load_peer()


@pytest.fixture
def endpoint() -> str:
    """An endpoint on this machine that nobody uses."""
    return free_endpoint()


class Process:
    """Another process and the lines that it says."""

    def __init__(self, popen: "subprocess.Popen[str] | ForkedProcess") -> None:
        self.popen = popen
        self.lines: list[str] = []
        self.errors: list[str] = []
        self._queue: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._readers = [
            threading.Thread(target=self._read, daemon=True),
            threading.Thread(target=lambda: self.errors.extend(self.popen.stderr), daemon=True),
        ]
        for reader in self._readers:
            reader.start()

    def _read(self) -> None:
        for line in self.popen.stdout:
            self.lines.append(line.strip())
            self._queue.put(line.strip())

    def tell(self, line: str) -> None:
        """Give it a command."""
        self.popen.stdin.write(line + "\n")
        self.popen.stdin.flush()

    def expect(self, start: str, timeout: float = PATIENCE) -> str:
        """The next line that begins with `start`."""
        deadline = time.monotonic() + timeout
        while True:
            try:
                line = self._queue.get(timeout=max(0.01, deadline - time.monotonic()))
            except queue.Empty:
                raise AssertionError(f"no {start!r}; said {self.lines[-5:]}, {self.errors[-5:]}") from None
            if line.startswith(start):
                return line

    def send(self, number: signal.Signals) -> None:
        """Send a signal to it."""
        self.popen.send_signal(number)

    def kill(self) -> None:
        """End it at once, even when it is stopped."""
        self.popen.kill()
        self.popen.wait(PATIENCE)

    def wait(self, timeout: float = PATIENCE) -> int:
        """Its exit code; fails when it does not end."""
        code = self.popen.wait(timeout)
        for reader in self._readers:
            reader.join(timeout)
        return code


def new_program(*arguments: str) -> "subprocess.Popen[str]":
    """A new interpreter that runs `peer.py`."""
    pipes = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
    return subprocess.Popen([sys.executable, str(PEER), *arguments], text=True, **pipes)


def starter(launch: Callable[..., "subprocess.Popen[str] | ForkedProcess"]) -> Iterator[Callable[..., Process]]:
    started: list[Process] = []

    def begin(*arguments: str) -> Process:
        process = Process(launch(*arguments))
        started.append(process)
        process.expect("ready")
        return process

    yield begin
    for process in started:
        if process.popen.poll() is None:
            process.kill()


def forked_program(*arguments: str) -> ForkedProcess:
    """A process that runs `peer.py`, forked where everything is imported already."""
    return ForkedProcess(PEER, *arguments)


@pytest.fixture
def start() -> Iterator[Callable[..., Process]]:
    """Starts a process of `peer.py` and waits until it is ready; all are ended with the test."""
    yield from starter(forked_program)


@pytest.fixture
def start_program() -> Iterator[Callable[..., Process]]:
    """As `start`, but each in an interpreter of its own, from its start to its end."""
    yield from starter(new_program)


@pytest.fixture(scope="module")
def shared_node() -> Iterator[tuple[Process, str]]:
    """A node for all tests of a file that do it no harm, and its endpoint."""
    for begin in starter(forked_program):
        endpoint = free_endpoint()
        yield begin("node", endpoint), endpoint


@pytest.fixture
def slow_link() -> Iterator[Callable[[str, float], SlowLink]]:
    """Makes slow links; all end with the test."""
    made: list[SlowLink] = []

    def make(target: str, rate: float) -> SlowLink:
        made.append(SlowLink(target, rate))
        return made[-1]

    yield make
    for link in made:
        link.close()


@pytest.fixture
def eventually() -> Callable[[Callable[[], bool]], bool]:
    """Asks until the answer is yes, or patience ends."""

    def ask(condition: Callable[[], bool], timeout: float = PATIENCE) -> bool:
        deadline = time.monotonic() + timeout
        while not condition():
            if time.monotonic() > deadline:
                return False
            time.sleep(0.01)
        return True

    return ask
