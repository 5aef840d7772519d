"""Every thread of a node, and of the gait and planner beside it, is killed by its name, and that is told.

`pytest -s tests/guara_perception/app/node/test_threads.py` prints a table of the threads that were killed.
"""

import ctypes
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path

import pytest

import guara_perception as gp
from guara_perception.app.exit_codes import EXIT_THREAD_FAILED
from guara_perception.app.main import run
from guara_perception.app.node import node as node_module
from guara_perception.app.node.recorder import ScanRecorder
from tests.guara_perception.app.node import conftest
from tests.guara_perception.app.node.live_bench import TIMEOUT, Bench, wait_until
from transport import Health, PausePhase, ScanFailed, StatusItem
from transport.messages.status_message import STATUS_NAME
from transport.supervision import THREADS_NAME

pytestmark = pytest.mark.slow
BenchWith = Callable[..., AbstractContextManager[Bench]]
# Threads for single tasks; each has its own test.
TASKS = {"scan", "transport-scan", "transport-deadline", "transport-outbox recording"}


class Killed(BaseException):
    """Not an `Exception`, because loops that survive those must end too."""


def kill(thread: threading.Thread) -> None:
    """Raise `Killed` in a thread, wherever it is; a wait of the thread is ended, as waits may end at any time."""
    assert thread.ident is not None
    assert ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(thread.ident), ctypes.py_object(Killed)) == 1
    frame = sys._current_frames().get(thread.ident)
    while frame is not None:
        waited_for = frame.f_locals.get("self")
        if frame.f_code.co_name == "wait" and isinstance(waited_for, threading.Condition):
            with waited_for:
                waited_for.notify_all()
            return
        frame = frame.f_back


def waits_for(thread: threading.Thread) -> str:
    """Names of the conditions on which a thread waits, from the innermost outwards."""
    frame = sys._current_frames().get(thread.ident or 0)
    names = []
    while frame is not None:
        names.append(getattr(frame.f_locals.get("predicate"), "__name__", ""))
        frame = frame.f_back
    return " ".join(names)


def threads() -> list[threading.Thread]:
    """Threads of the product in this process, without those of the test runner."""
    ours = (thread for thread in threading.enumerate() if thread.name.startswith(("guara-", "transport-", "scan")))
    # It waits for the end of the main thread in a single call, in which nothing can be raised.
    return [thread for thread in ours if thread.name != "transport-exit-watcher"]


def item_of(bench: Bench, name: str) -> StatusItem | None:
    status = bench.client.status()
    return None if status is None else status.item(name)


def is_over(bench: Bench) -> bool:
    """True if the node reports that no pause is under way."""
    item = item_of(bench, STATUS_NAME)
    return item is not None and item.values["standing"] == "false"


@pytest.fixture
def earlier_threads() -> set[threading.Thread]:
    """Client threads that earlier tests left to end by themselves."""
    return set(threads())


@pytest.fixture
def slow_bench(
    earlier_threads: set[threading.Thread],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    calibration: gp.Calibration,
    request: pytest.FixtureRequest,
) -> Iterator[Bench]:
    """Node with a recorder, with scans slow enough for each thread to be killed during one."""
    monkeypatch.setattr(conftest, "FPS", 10.0)
    bench_with: BenchWith = request.getfixturevalue("bench_with")
    with (
        ScanRecorder(tmp_path / "walk.mcap", robot="guara", calibration=calibration) as recorder,
        bench_with(recorder) as bench,
    ):
        yield bench


def test_each_thread_that_is_killed_is_told(slow_bench: Bench, earlier_threads: set[threading.Thread]) -> None:
    """Laser off, pause over, status ERROR with the thread's name, and the thread is restarted."""
    bench, board, names = slow_bench, slow_bench.rig.board, []
    bench.client.on_terrain(lambda terrain: None)
    killed: set[threading.Thread] = set()
    for step in range(60):
        bench.gait.say(step, PausePhase.BEGIN)
        assert wait_until(lambda: board.view().laser_on)
        passed_over = killed | earlier_threads
        thread = next((thread for thread in threads() if thread not in passed_over and thread.name not in TASKS), None)
        if thread is None:
            break
        killed.add(thread)
        names.append(thread.name)
        begun = time.monotonic()
        kill(thread)
        assert wait_until(lambda: is_over(bench) and not board.view().laser_on), thread.name
        dark_after = time.monotonic() - begun

        def is_told(name: str = thread.name) -> bool:
            item = item_of(bench, THREADS_NAME)
            return item is not None and item.level is Health.ERROR and f"{name} failed" in item.message

        assert wait_until(is_told), thread.name
        assert thread.is_alive(), thread.name
        print(f"{thread.name:45} laser off after {dark_after:5.2f} s, ERROR, restarted")
    assert {"guara-scans", "transport-pulse", "transport-status"} < set(names)
    print(f"threads killed {len(killed)}, told {len(names)}")
    # All threads work again.
    bench.gait.say(60, PausePhase.BEGIN)
    assert bench.client.wait_for_step(60, timeout=TIMEOUT).step == 60


def test_a_scan_whose_thread_is_killed_is_told(slow_bench: Bench) -> None:
    """The driver thread that grabs frames: laser off, health failed, and the next pause is scanned."""
    slow_bench.gait.say(0, PausePhase.BEGIN)
    assert wait_until(lambda: slow_bench.rig.board.view().laser_on)
    kill(next(thread for thread in threads() if thread.name == "scan"))
    terrain = slow_bench.client.wait_for_step(0, timeout=TIMEOUT)
    assert not slow_bench.rig.board.view().laser_on
    assert terrain.metadata["health"]["level"] == "failed"
    assert any("thread 'scan' failed: Killed()" in reason for reason in terrain.metadata["health"]["reasons"])


@pytest.mark.parametrize("name", ["transport-scan", "transport-deadline"])
def test_a_request_whose_thread_is_killed_is_told(slow_bench: Bench, name: str) -> None:
    """The client gets an error or its grid, and the node does not stay busy."""
    bench, heard = slow_bench, []

    def ask() -> None:
        try:
            heard.append(bench.client.request_scan(mode="coarse", timeout=TIMEOUT))
        except ScanFailed as error:
            heard.append(error)

    bench.gait.say(0, PausePhase.BEGIN)
    assert bench.client.wait_for_step(0, timeout=TIMEOUT).step == 0
    asker = threading.Thread(target=ask)
    asker.start()
    assert wait_until(lambda: slow_bench.rig.board.view().laser_on)
    kill(next(thread for thread in threads() if thread.name == name))
    assert wait_until(lambda: is_over(bench) and not bench.rig.board.view().laser_on)
    asker.join(TIMEOUT)
    assert len(heard) == 1 and isinstance(heard[0], ScanFailed)
    item = item_of(bench, THREADS_NAME)
    assert item is not None and item.level is Health.ERROR and f"{name} failed" in item.message
    bench.gait.say(1, PausePhase.BEGIN)
    assert bench.client.wait_for_step(1, timeout=TIMEOUT).step == 1
    assert bench.client.request_scan(mode="coarse", timeout=TIMEOUT).step == 1


def test_a_scan_thread_that_hangs_is_told(
    slow_bench: Bench, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
) -> None:
    """It stays in a call for longer than allowed: laser off and status ERROR, although the thread is alive."""
    bench, release = slow_bench, threading.Event()
    request.addfinalizer(release.set)
    monkeypatch.setattr(node_module, "HANG_TIME_S", 1.0)
    monkeypatch.setattr(gp.ScanProcessor, "add_all", lambda *arguments: release.wait(TIMEOUT))
    bench.gait.say(0, PausePhase.BEGIN)
    assert wait_until(lambda: bench.rig.board.view().laser_on)

    def is_told() -> bool:
        item = item_of(bench, "thread guara-scans")
        return item is not None and item.level is Health.ERROR and "no progress for more than 1 s" in item.message

    assert wait_until(is_told)
    assert wait_until(lambda: not bench.rig.board.view().laser_on)
    release.set()
    assert wait_until(lambda: not is_told())


def test_a_node_whose_thread_fails_again_and_again_ends_with_its_exit_code(
    free_endpoint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """So that a service manager can react."""
    over = threading.Event()

    def kill_again_and_again() -> None:
        deadline = time.monotonic() + TIMEOUT
        while not over.wait(0.05) and time.monotonic() < deadline:
            for thread in threads():
                # Not while it waits for its restart, since that would kill the supervision itself.
                if thread.name == "guara-scans" and "_has_work" in waits_for(thread):
                    kill(thread)
        if not over.is_set():
            os.kill(os.getpid(), signal.SIGINT)

    killer = threading.Thread(target=kill_again_and_again)
    killer.start()
    try:
        code = run(["run", "--simulated", "--listen", free_endpoint])
    finally:
        over.set()
        killer.join()
    assert code == EXIT_THREAD_FAILED == 3
    said = capsys.readouterr()
    assert "stopped, laser off" in said.out
    assert "guara-scans failed for good: Killed" in said.err
