"""The thread that writes for others: order, its limit, errors of a task, and its end."""

import logging
import threading

import pytest

from guara_perception.app.node.writer_thread import WriterThread


def test_tasks_run_in_order_and_closing_waits_for_them():
    """What was handed over is done, in its order, when it is closed; later tasks are refused."""
    done: list[int] = []
    writer = WriterThread("test", 100)
    for number in range(50):
        assert writer.post(0, lambda n=number: done.append(n))
    assert writer.close(10.0)
    assert done == list(range(50))
    assert not writer.post(0, lambda: done.append(-1))


def test_more_than_the_limit_is_refused_until_something_is_done():
    """Tasks that hold memory are refused beyond the limit, those that hold none never; finished ones do not count."""
    go, has_begun = threading.Event(), threading.Event()
    writer = WriterThread("test", 100)

    def wait() -> None:
        has_begun.set()
        go.wait(10.0)

    assert writer.post(60, wait) and has_begun.wait(10.0)
    assert not writer.post(41, wait) and writer.post(40, wait) and writer.post(0, wait)
    assert writer.waiting == 100 and not writer.flush(0.0)
    go.set()
    assert writer.flush(10.0) and writer.waiting == 0
    assert writer.post(100, wait) and writer.close(10.0)


def test_an_error_of_a_task_is_logged_and_the_next_one_runs(caplog: pytest.LogCaptureFixture):
    """A task that fails takes none of the others with it."""
    done = threading.Event()
    writer = WriterThread("test", 100)
    with caplog.at_level(logging.ERROR):
        writer.post(1, lambda: 1 / 0)
        writer.post(1, done.set)
        assert writer.close(10.0)
    assert done.is_set() and writer.waiting == 0
    assert "writing failed" in caplog.text and "ZeroDivisionError" in caplog.text


def test_what_is_too_slow_does_not_hold_up_the_end():
    """Closing gives up after its time, takes nothing more, and what waits goes on."""
    go, done = threading.Event(), threading.Event()
    writer = WriterThread("test", 100)
    writer.post(0, lambda: go.wait(10.0))
    writer.post(0, done.set)
    assert not writer.close(0.01) and not writer.post(0, go.set)
    go.set()
    assert done.wait(10.0)
