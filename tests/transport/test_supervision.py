"""Failures of threads and callbacks: told to followers, logged, answered by a bounded number of restarts."""

import ast
import logging
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.ports import free_endpoint
from transport import Health, Outbox, ReceiveTimeout, SessionClosed, open_node
from transport.supervision import RESTARTS, Failure, FailureLog, follow, forget, guarded, report, supervised

TIMEOUT = 30.0
ROOT = Path(__file__).parents[2]
# Files that may make threads themselves: the mechanism; the drivers, which know nothing of it and hand what ends a
# thread of theirs to whoever waits for its frames; the last resort when closing hangs; emulators, which no robot runs.
MAY_MAKE_THREADS = (
    "transport/supervision.py",
    "drivers/sweep/stripe_worker.py",
    "drivers/cameras/opencv_camera.py",
    "guara_perception/app/until_stopped.py",
    "drivers/emulator/",
)


@pytest.fixture
def told(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[Failure]]:
    """What is told while a test runs; restarts without a delay."""
    monkeypatch.setattr("transport.supervision.RESTART_DELAY", 0.0)
    failures: list[Failure] = []
    follow(failures.append)
    yield failures
    forget(failures.append)


def test_no_file_of_the_product_makes_a_thread_otherwise() -> None:
    """`threading.Thread` and `Timer`, called or derived from, and executors of threads."""
    names = {"Thread", "Timer", "ThreadPoolExecutor", "start_new_thread"}
    found = set()
    for package in ("transport", "drivers", "kinematics", "guara_perception"):
        for path in (ROOT / package).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text())):
                made = (
                    [node.func] if isinstance(node, ast.Call) else node.bases if isinstance(node, ast.ClassDef) else []
                )
                if any(getattr(one, "attr", getattr(one, "id", "")) in names for one in made):
                    found.add(str(path.relative_to(ROOT)))
    assert "transport/supervision.py" in found
    assert {path for path in found if not path.startswith(MAY_MAKE_THREADS)} == set()


@pytest.mark.parametrize("error", [ValueError("no route"), SystemExit(0), KeyboardInterrupt()])
def test_a_thread_is_restarted_so_often_and_then_has_failed_for_good(
    told: list[Failure], error: BaseException, caplog: pytest.LogCaptureFixture
) -> None:
    """What an exception is, does not matter: Python would end the thread by `SystemExit` without a word."""
    owner: list[Failure] = []

    def fail() -> None:
        raise error

    thread = supervised("a part", fail, on_failure=owner.append)
    thread.start()
    thread.join(TIMEOUT)
    assert [failure.is_final for failure in told] == [False] * RESTARTS + [True]
    assert owner == told
    assert str(told[-1]).startswith(f"a part failed for good: {type(error).__name__}")
    last = [record.message for record in caplog.records if record.levelno == logging.CRITICAL]
    assert len(last) == 1 and last[0].startswith(str(told[-1]))


def test_a_thread_that_comes_back_does_its_work(told: list[Failure]) -> None:
    """Failures far apart are never the last."""
    calls = iter([ValueError("once"), None])

    def work() -> None:
        error = next(calls)
        if error is not None:
            raise error

    thread = supervised("a part", work)
    thread.start()
    thread.join(TIMEOUT)
    assert [failure.is_final for failure in told] == [False]
    assert next(calls, "none left") == "none left"


def test_failures_long_ago_do_not_count(told: list[Failure], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("transport.supervision.RESTART_PERIOD", 0.0)
    errors = iter([ValueError("again")] * 3 * RESTARTS)

    def work() -> None:
        for error in errors:
            raise error

    thread = supervised("a part", work)
    thread.start()
    thread.join(TIMEOUT)
    assert [failure.is_final for failure in told] == [False] * 3 * RESTARTS


def test_a_task_that_fails_is_told_and_not_repeated(told: list[Failure]) -> None:
    thread = supervised("a task", lambda: sys.exit(3), restarts=None)
    thread.start()
    thread.join(TIMEOUT)
    assert [(failure.part, failure.is_final) for failure in told] == [("a task", False)]
    assert str(told[0]) == "a task failed: SystemExit: 3"


def test_no_exception_leaves_a_callback_of_somebody_elses_thread(told: list[Failure]) -> None:
    def on_sample(sample: int) -> None:
        if sample:
            sys.exit(sample)

    call = guarded(on_sample)
    call(0)
    assert told == []
    call(1)
    assert [failure.part.rpartition(".")[2] for failure in told] == ["on_sample"]
    assert told[0].part.startswith("callback ")


def test_a_follower_that_fails_keeps_no_other_from_hearing(told: list[Failure]) -> None:
    def fail(failure: Failure) -> None:
        raise ValueError

    follow(fail)
    try:
        later: list[Failure] = []
        follow(later.append)
        report("a part", ValueError("no route"))
        forget(later.append)
        assert later == told and len(told) == 1
    finally:
        forget(fail)


def test_the_status_names_every_part_that_failed(told: list[Failure], monkeypatch: pytest.MonkeyPatch) -> None:
    """As an error at first, later as a warning; one that is dead for good is an error for ever."""
    changes: list[bool] = []
    log = FailureLog(lambda: changes.append(True))
    assert log.items() == []
    report("one", ValueError("no route"))
    report("two", ValueError("no way"))
    (item,) = log.items()
    assert item.level is Health.ERROR
    assert "one failed and continues: ValueError: no route; two failed" in item.message
    assert (item.values["failures"], item.values["parts"], len(changes)) == ("2", "one, two", 2)
    monkeypatch.setattr("transport.supervision.ERROR_TIME", 0.0)
    assert log.items()[0].level is Health.WARN
    report("two", ValueError("no way"), is_final=True)
    (item,) = log.items()
    assert (item.level, item.values["failures"]) == (Health.ERROR, "3")
    assert item.message == "two failed for good: ValueError: no way"
    log.close()
    report("three", ValueError("no"))
    assert log.items() == [item]


def test_a_lane_of_an_outbox_outlives_an_action_that_ends_its_thread(told: list[Failure]) -> None:
    """What waits behind it is sent; after too many a new thread takes the next action."""
    outbox, sent = Outbox(), []
    outbox.post("bad", lambda: sys.exit(1), lane="one")
    outbox.post("good", lambda: sent.append(1), lane="one")
    outbox.flush(TIMEOUT)
    assert sent == [1]
    for number in range(RESTARTS + 1):
        outbox.post(f"bad {number}", lambda: sys.exit(1), lane="two")
    try:
        outbox.flush(TIMEOUT)
    except ReceiveTimeout:
        pytest.fail("the lane is blocked")
    outbox.post("good", lambda: sent.append(2), lane="two")
    outbox.flush(TIMEOUT)
    assert sent == [1, 2]
    assert {failure.part for failure in told} == {"transport-outbox one", "transport-outbox two"}
    outbox.close()


def test_a_session_whose_thread_failed_for_good_says_so_to_whoever_uses_it(told: list[Failure]) -> None:
    def fail() -> None:
        raise ValueError("no route")

    with open_node(listen=free_endpoint()) as session:
        thread = session.thread("a part", fail)
        thread.start()
        thread.join(TIMEOUT)
        assert session.is_closed and not threading.current_thread().daemon
        with pytest.raises(SessionClosed, match="a part failed for good: ValueError: no route"):
            _ = session.raw


def test_what_is_pending_in_one_lane_is_told_of_that_lane() -> None:
    """Other lanes wait for something else."""
    outbox, goes, begun = Outbox(), threading.Event(), threading.Semaphore(0)

    def wait() -> None:
        begun.release()
        goes.wait(TIMEOUT)

    for lane, count in (("one", 2), ("two", 5)):
        for number in range(count):
            outbox.post(str(number), wait, lane=lane)
    try:
        assert all(begun.acquire(timeout=TIMEOUT) for _ in range(2))
        with pytest.raises(ReceiveTimeout, match="pending: 2$"):
            outbox.flush(0.0, lane="one")
        with pytest.raises(ReceiveTimeout, match="pending: 7$"):
            outbox.flush(0.0)
    finally:
        goes.set()
        outbox.close()
