"""What a session repeats: by one thread, in order, until it is taken away."""

from __future__ import annotations

import logging
import threading

import pytest

from transport.links.pulse import Pulse


def test_all_are_called_on_one_thread_the_first_first_and_one_that_fails_stops_no_other(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("transport.links.pulse.PERIOD", 0.02)
    pulse, called, round_over = Pulse(), [], threading.Event()

    def fail() -> None:
        called.append("fails")
        raise ValueError("no route")

    def last() -> None:
        called.append(threading.current_thread().name)
        round_over.set()

    pulse.add("fails", fail)
    pulse.add("last", last)
    pulse.add("early", lambda: called.append("early"), first=True)
    try:
        assert round_over.wait(20.0)
        pulse.remove("fails")
        pulse.remove("fails")
        round_over.clear()
        assert round_over.wait(20.0)
        round_over.clear()
        begun = len(called)
        assert round_over.wait(20.0)
    finally:
        pulse.close()
    # The thread starts with the first that is added: a beat may have come before all were there.
    whole = called[called.index("early") :] if "early" in called else []
    assert whole[:3] == ["early", "fails", "transport-pulse"]
    assert "fails" not in called[begun:]
    errors = [record.message for record in caplog.records if record.levelno == logging.ERROR]
    assert any("fail failed and continues: ValueError: no route" in message for message in errors)
    pulse.close()


def test_a_closed_one_calls_nothing_and_takes_in_without_a_thread() -> None:
    pulse = Pulse()
    pulse.close()
    pulse.add("late", lambda: pytest.fail("called after close"))
    assert not any(thread.name == "transport-pulse" for thread in threading.enumerate())
