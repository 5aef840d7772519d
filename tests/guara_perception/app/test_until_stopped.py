"""Ctrl-C and SIGTERM are handled on whichever thread they arrive."""

from __future__ import annotations

import subprocess
import sys

import pytest

# Longest time for an expected event on a busy machine [s].
PATIENCE = 180.0
BEGIN = """
import signal, threading, time
from guara_perception.app.until_stopped import stop_event
"""
# The system may deliver a signal to any thread, and only the main thread runs Python's handlers.
GIVEN_TO_ANOTHER_THREAD = """
with stop_event() as stop:
    threading.Timer(0.5, lambda: signal.pthread_kill(threading.get_ident(), signal.{name})).start()
    stop.wait()
print("stopped")
"""
WITHIN_ITS_OWN_LOCK = """
with stop_event() as stop:
    with stop._cond:
        signal.raise_signal(signal.{name})
    stop.wait()
print("stopped")
"""


def run(program: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", BEGIN + program], capture_output=True, text=True, timeout=PATIENCE, check=False
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
@pytest.mark.parametrize("program", [GIVEN_TO_ANOTHER_THREAD, WITHIN_ITS_OWN_LOCK])
def test_a_signal_is_heard_wherever_it_arrives(program: str, name: str) -> None:
    """On another thread, and on the main thread while it holds the event's lock: the program ends in both cases."""
    result = run(program.format(name=name))
    assert (result.returncode, result.stdout) == (0, "stopped\n"), result.stderr
