"""Devices that hang while closing do not delay the end of a command."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from typing import Any, Self

import pytest

from guara_perception.app.until_stopped import closed_within
from tests.forked import ForkedProcess

# Longest time for an expected event on a busy machine [s].
PATIENCE = 180.0
PROGRAM = """
import ctypes, threading
from guara_perception.app.until_stopped import closed_within

class Device:
    def __enter__(self): return self
    def __exit__(self, *failure): {hang}

with closed_within(Device(), 0.5):
    print("used", flush=True)
print("closed")
"""


def run(hang: str) -> subprocess.CompletedProcess[str]:
    """Run a program whose device executes `hang` when it is closed."""
    program = PROGRAM.format(hang=hang)
    return subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=PATIENCE, check=False
    )


@pytest.mark.slow
def test_a_device_that_hangs_is_left_behind_in_words() -> None:
    result = run("threading.Event().wait()")
    assert (result.returncode, result.stdout) == (1, "used\n")
    assert result.stderr.startswith("guara: camera or laser board did not close within 0.5 s; exiting anyway")
    assert "Traceback" not in result.stderr


@pytest.mark.slow
def test_a_driver_that_keeps_pythons_lock_is_left_behind_too() -> None:
    """No Python thread runs any more; the traceback shows where the driver hangs."""
    result = run("ctypes.PyDLL(None).pause()")
    assert (result.returncode, result.stdout) == (1, "used\n")
    assert "__exit__" in result.stderr


class Slow:
    """Device that is used for longer than it may take to close."""

    closed = False

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *failure: Any) -> None:
        self.closed = True


@pytest.mark.slow
def test_only_closing_is_bounded_and_a_device_that_closes_ends_nothing() -> None:
    device = Slow()
    with pytest.raises(KeyError), closed_within(device, 0.05):
        time.sleep(0.3)
        raise KeyError
    assert device.closed
    time.sleep(0.3)


NODE = """
import sys, threading
from guara_perception.app import main, until_stopped
from guara_perception.app.node.rangefinder import Rangefinder

closed = Rangefinder.__exit__

def hang(rangefinder, *failure):
    closed(rangefinder, *failure)
    threading.Event().wait()

until_stopped.CLOSE_TIMEOUT_S, Rangefinder.__exit__ = 0.5, hang
sys.exit(main.run(["run", "--simulated", "--listen", sys.argv[1]]))
"""


@pytest.mark.slow
def test_a_running_node_ends_although_its_devices_hang(free_endpoint: str) -> None:
    """It ends with an error, and does not claim that the laser is off."""
    node = ForkedProcess("-c", NODE, free_endpoint)
    try:
        assert "listening on" in node.stdout.readline()
        node.send_signal(signal.SIGINT)
        printed, complaint = node.communicate(timeout=PATIENCE)
    finally:
        node.kill()
    assert node.returncode == 1 and "did not close within 0.5 s" in complaint
    assert "laser off" not in printed
