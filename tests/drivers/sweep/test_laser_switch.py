"""Laser switch of a scan."""

import dataclasses

import pytest

from drivers import BoardFault, LaserBoard
from drivers.emulator import EmulatorConfig
from drivers.errors import LaserRefused
from drivers.sweep.stripe_worker import LaserSwitch, ScanStopped
from testbed.bench_board import BenchBoard, Fault, FaultKind, bench_backend


def test_after_closing_nothing_switches_on(board: LaserBoard, emulated: BenchBoard) -> None:
    """A delayed scan thread cannot switch the laser on again."""
    switch = LaserSwitch(board)
    switch.on()
    assert switch.lit and emulated.view().laser_on
    switch.close()
    with pytest.raises(ScanStopped):
        switch.on()
    with pytest.raises(ScanStopped):
        switch.keep_on(False)
    assert not switch.lit and not emulated.view().laser_on


def test_laser_put_out_by_the_board_is_switched_on_again_and_counted() -> None:
    """A watchdog fault is cleared once, and the interruption is counted."""
    now = [100.0]
    emulated = BenchBoard(clock=lambda: now[0])
    with LaserBoard(backend=bench_backend(emulated)) as board:
        switch = LaserSwitch(board)
        switch.on()
        now[0] += 1.0
        status = board.status()
        assert status.faults == BoardFault.WATCHDOG
        switch.keep_on(status.laser_commanded)
        assert switch.interruptions == 1 and emulated.view().laser_on
        switch.keep_on(True)
        assert switch.interruptions == 1


def test_a_fault_that_stays_is_raised(board: LaserBoard, emulated: BenchBoard) -> None:
    """Over-temperature cannot be cleared."""
    emulated.inject(Fault(FaultKind.HOT, amount=80))
    with pytest.raises(LaserRefused, match="too hot"):
        LaserSwitch(board).on()


def test_laser_rests_before_its_time_limit() -> None:
    """A scan longer than the limit never reaches it, because the laser rests in between."""
    identity = dataclasses.replace(EmulatorConfig().identity, watchdog=20.0, laser_limit=0.2, laser_rest=0.02)
    emulated = BenchBoard(dataclasses.replace(EmulatorConfig(), identity=identity))
    with LaserBoard(backend=bench_backend(emulated)) as board:
        switch = LaserSwitch(board)
        switch.on()
        started = emulated.view().laser_since
        while emulated.view().time - started < 0.12:
            board.status()
        switch.keep_on(board.status().laser_commanded)
        dark = [event for event in emulated.switchings() if not event.on and event.time > started]
        assert dark and emulated.view().laser_on
        assert emulated.view().laser_since - dark[-1].time >= identity.laser_rest
