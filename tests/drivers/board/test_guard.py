"""The laser goes off however its host process ends: by a signal, at exit or killed."""

import signal
import time
from collections.abc import Callable

import pytest

from drivers.board import guard
from drivers.board.protocol import BoardFault
from testbed.remote_board import RemoteBoard
from tests.drivers.conftest import PATIENCE
from tests.forked import ForkedProcess

OPEN_AND_WAIT = """
import sys, time
from drivers import LaserBoard
from testbed.remote_board import remote_backend
board = LaserBoard(backend=remote_backend(sys.argv[1]))
{open}
board.laser_on()
print("on")
{then}
"""
KEEP_ALIGHT = "while True:\n    board.status(); time.sleep(0.02)"

Host = Callable[..., ForkedProcess]


def begin(host: Host, address: str, then: str = KEEP_ALIGHT, open_: str = "board.open()") -> tuple:
    remote = RemoteBoard(address)
    process = host(OPEN_AND_WAIT.format(open=open_, then=then), address)
    assert process.stdout.readline() == "on\n"
    assert any(event.on for event in remote.switchings())
    return process, remote


def test_watchdog_puts_the_laser_out_when_the_host_is_killed(emulator_process, host: Host, eventually) -> None:
    """After kill -9 the host cannot switch off; without requests, the board turns the laser off itself."""
    process, remote = begin(host, emulator_process.address)
    time.sleep(0.7)
    assert remote.view().laser_on, "a living host keeps the laser on beyond the watchdog's time"
    killed = time.monotonic()
    process.kill()
    process.wait(PATIENCE)
    eventually(lambda: not remote.view().laser_on)
    off = remote.switchings()[-1]
    # On the emulator's clock: this is the limit of the protocol, not a measure of this machine's speed.
    assert not off.on and off.time - killed <= 0.6
    assert BoardFault.WATCHDOG in BoardFault(remote.view().faults)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGINT])
def test_signals_switch_off_rather_than_wait_for_the_watchdog(
    emulator_process, host: Host, number: signal.Signals, eventually
) -> None:
    """A signalled host turns the laser off before it ends, also without a `with` block."""
    process, remote = begin(host, emulator_process.address)
    process.send_signal(number)
    status = process.wait(PATIENCE)
    assert status == (128 + number if number != signal.SIGINT else -signal.SIGINT)
    assert not remote.view().laser_on
    assert BoardFault.WATCHDOG not in BoardFault(remote.view().faults)


@pytest.mark.parametrize("then", ["", "raise RuntimeError('lost')", "sys.exit(3)"])
def test_end_of_the_program_switches_off(emulator_process, host: Host, then: str) -> None:
    """A program that does not close the board leaves it dark at exit, also after an exception."""
    process, remote = begin(host, emulator_process.address, then)
    process.wait(PATIENCE)
    assert not remote.view().laser_on
    assert BoardFault.WATCHDOG not in BoardFault(remote.view().faults)


def test_handlers_of_the_program_are_left_alone(emulator_process, host: Host) -> None:
    """A program with its own SIGTERM handler keeps it."""
    own = "import signal; signal.signal(signal.SIGTERM, lambda *_: print('mine'))\nboard.open()"
    process, remote = begin(host, emulator_process.address, KEEP_ALIGHT, own)
    process.send_signal(signal.SIGTERM)
    assert process.stdout.readline() == "mine\n"
    assert process.poll() is None
    process.send_signal(signal.SIGINT)
    process.wait(PATIENCE)
    assert not remote.view().laser_on


class Fake:
    """Closable object."""

    def __init__(self, fails: bool = False) -> None:
        self.closed, self.fails = 0, fails

    def close(self) -> None:
        self.closed += 1
        if self.fails:
            raise OSError("gone")


def test_signal_handlers_are_taken_and_given_back() -> None:
    """While a device is watched, SIGTERM unwinds; afterwards the handlers are as before."""
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    first, second = Fake(), Fake()
    guard.watch(first)
    guard.watch(second)
    with pytest.raises(SystemExit) as caught:
        signal.raise_signal(signal.SIGTERM)
    assert caught.value.code == 128 + signal.SIGTERM
    guard.release(first)
    assert signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL
    guard.release(second)
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL


def test_signals_can_be_left_alone() -> None:
    """`handle_signals=False` changes no handler."""
    device = Fake()
    guard.watch(device, handle_signals=False)
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    guard.release(device)


def test_one_failing_device_does_not_keep_the_others_open() -> None:
    """At exit every device is closed, even after a failure."""
    devices = [Fake(fails=True), Fake()]
    for device in devices:
        guard.watch(device)
    guard._close_all()
    assert [device.closed for device in devices] == [1, 1]
    for device in devices:
        guard.release(device)
