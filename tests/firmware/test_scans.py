"""Whole scans through `acquire`: the driver and pyusb over the firmware on its chip, in the chip's time."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from drivers import AcquireOptions, BoardConfig, BoardFault, LaserBoard, OffFrames, SweepOptions, acquire, prepare
from drivers.emulator.backend import EmulatedBackend
from drivers.errors import LaserRefused
from testbed.bench_board import BenchCamera
from testbed.chip import Chip, ChipBus, ChipClock
from testbed.triggered_camera import EmulatedTriggeredCamera
from tests.drivers.conftest import Scene

pytestmark = pytest.mark.chip

STRIPES = 70
FIRING_ORDER = [(index, -0.14 + 0.46 * index / (STRIPES - 1)) for index in range(STRIPES)]


@pytest.fixture
def bus(new_chip: Callable[[], Chip]) -> ChipBus:
    return ChipBus(new_chip())


@pytest.fixture
def board(bus: ChipBus) -> Iterator[LaserBoard]:
    """The driver on the chip; all use its clock."""
    with ChipClock(bus), LaserBoard(BoardConfig(handle_signals=False), backend=EmulatedBackend(bus)) as device:
        yield device


@pytest.fixture
def camera(board: LaserBoard, bus: ChipBus) -> Iterator[BenchCamera]:
    with BenchCamera(bus, Scene(), fps=60.0, exposure=0.004, latency=0.004) as device:
        yield device


@pytest.mark.parametrize("off", list(OffFrames))
def test_a_whole_scan_is_in_step(board: LaserBoard, camera: BenchCamera, bus: ChipBus, off: OffFrames) -> None:
    """70 stripes, each proved by its picture, in each of the three ways to take off frames; dark afterwards."""
    prepare(board, FIRING_ORDER)
    with acquire(board, camera, FIRING_ORDER, AcquireOptions(off=off)) as stripes:
        indices = [stripe.index for stripe in stripes]
    report = stripes.report
    assert indices == [index for index, _ in FIRING_ORDER]
    assert report.in_step and not report.problems and not report.failure
    assert not bus.chip.world.lit
    assert prepare(board, FIRING_ORDER) == 0
    assert bus.chip.host.wrong_toggles == 0 and bus.chip.resets == 0


@pytest.mark.parametrize("wired", [False, True])
def test_the_board_sweeps_by_itself(board: LaserBoard, bus: ChipBus, wired: bool) -> None:
    """The firmware triggers the camera; 70 of 70 stripes are proved, also when it misses some triggers."""
    shutter = bus.chip.wiring.shutter
    shutter.wired, shutter.missed = wired, frozenset({1, 30})
    bus.chip.rewire()
    prepare(board, FIRING_ORDER)
    with (
        EmulatedTriggeredCamera(bus, shutter, Scene()) as triggered,
        acquire(board, triggered, FIRING_ORDER, AcquireOptions(sweep=SweepOptions())) as stripes,
    ):
        taken = list(stripes)
    assert sorted(stripe.index for stripe in taken) == [index for index, _ in FIRING_ORDER]
    assert stripes.report.in_step and not stripes.report.problems
    assert "stripes repeated: 2" in stripes.report.notes
    assert not bus.chip.world.lit and bus.chip.host.wrong_toggles == 0


def test_heat_in_a_scan_ends_it_in_the_dark(board: LaserBoard, camera: BenchCamera, bus: ChipBus) -> None:
    """The board puts the laser out and the scan says why."""
    prepare(board, FIRING_ORDER)
    taken = 0
    with pytest.raises(LaserRefused, match="too hot"), acquire(board, camera, FIRING_ORDER) as stripes:
        for _ in stripes:
            taken += 1
            if taken == 5:
                with bus.lock:
                    bus.chip.wiring.temperature = 65.0
                    bus.chip.rewire()
    assert not bus.chip.world.lit
    assert BoardFault.OVER_TEMPERATURE in board.status().faults
    assert "too hot" in stripes.report.problems[-1]


def test_steps_lost_in_a_scan_are_counted_after_it(board: LaserBoard, camera: BenchCamera, bus: ChipBus) -> None:
    """`prepare` between scans finds them at the home switch."""
    prepare(board, FIRING_ORDER)
    with acquire(board, camera, FIRING_ORDER[:10]) as stripes:
        for stripe in stripes:
            if stripe.index == 4:
                with bus.lock:
                    bus.chip.world.position -= 25
    assert prepare(board, FIRING_ORDER) == 25


def test_a_host_that_dies_in_a_scan_leaves_the_laser_off(board: LaserBoard, camera: BenchCamera, bus: ChipBus) -> None:
    """Nobody asks any more: 0.4 s later the laser is out, and the fault waits for the next host."""
    board.ensure_ready()
    board.laser_on()
    camera.grab(1.0)
    assert bus.chip.world.lit
    bus.chip.run(0.41)
    assert not bus.chip.world.lit
    assert BoardFault.WATCHDOG in board.status().faults
