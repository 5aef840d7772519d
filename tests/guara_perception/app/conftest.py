"""Fixtures for the tests of the application: a node in its own process, and the command line."""

import queue
import signal
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

import guara_perception as gp
from guara_perception.app.main import run
from tests.forked import ForkedProcess
from tests.ports import free_endpoint

PATIENCE = 180.0
"""[s] For anything that must happen at all; generous, because the machine may be loaded."""


class Process:
    """Separate process with its output lines and exit code."""

    def __init__(self, *arguments: str | Path) -> None:
        self.popen = ForkedProcess(*arguments)
        self.errors: list[str] = []
        self._said: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._readers = [
            threading.Thread(target=lambda: [self._said.put(line.rstrip()) for line in self.popen.stdout], daemon=True),
            threading.Thread(target=lambda: self.errors.extend(self.popen.stderr), daemon=True),
        ]
        for reader in self._readers:
            reader.start()

    def line(self, timeout: float = PATIENCE) -> str:
        """Return the next line of the output."""
        try:
            return self._said.get(timeout=timeout)
        except queue.Empty:
            raise AssertionError(f"nothing said within {timeout} s; errors: {self.errors[-5:]}") from None

    def tell(self, line: str) -> None:
        """Send a command, and wait for its "done"."""
        self.popen.stdin.write(line + "\n")
        self.popen.stdin.flush()
        assert self.line() == "done"

    def interrupt(self) -> int:
        """Send Ctrl-C, and return the exit code."""
        self.popen.send_signal(signal.SIGINT)
        return self.wait()

    def wait(self) -> int:
        """Return the exit code; fail if the process does not end."""
        code = self.popen.wait(PATIENCE)
        for reader in self._readers:
            reader.join(PATIENCE)
        return code

    def end(self) -> None:
        """End the process in any state."""
        self.popen.kill()
        self.wait()
        self.popen.close()


@pytest.fixture(scope="module")
def start() -> Iterator[Callable[..., Process]]:
    """Start Python processes; all are ended after the tests of the module."""
    started: list[Process] = []

    def begin(*arguments: str | Path) -> Process:
        started.append(Process(*arguments))
        return started[-1]

    yield begin
    for process in reversed(started):
        process.end()


@pytest.fixture(scope="module")
def module_endpoint() -> str:
    """Endpoint shared by the node and the tests of a module."""
    return free_endpoint()


@pytest.fixture(scope="session")
def terrain_file(paper_terrain: gp.TerrainGrid, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """File with the grid that the nodes publish."""
    path = tmp_path_factory.mktemp("terrain") / "paper.npz"
    paper_terrain.save(path)
    return path


class Said(NamedTuple):
    """Exit code and output of a command."""

    code: int
    out: str
    err: str


@pytest.fixture
def guara(capsys: pytest.CaptureFixture[str]) -> Callable[..., Said]:
    """Run a command line in this process."""

    def command(*arguments: str | Path) -> Said:
        code = run([str(word) for word in arguments])
        said = capsys.readouterr()
        return Said(code, said.out, said.err)

    return command


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Disable figures of scans, which take longer than all other steps and have their own tests."""
    monkeypatch.setattr("guara_perception.app.figures.figures.draw_figures", lambda *_: [])


def eventually(condition: Callable[[], bool]) -> bool:
    """Repeat a question until the answer is True, or time runs out."""
    deadline = time.monotonic() + PATIENCE
    while not condition():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.02)
    return True


@pytest.fixture(name="eventually")
def eventually_fixture() -> Callable[[Callable[[], bool]], bool]:
    """`eventually` as a fixture."""
    return eventually
