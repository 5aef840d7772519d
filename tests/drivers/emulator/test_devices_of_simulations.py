"""Devices of `--simulated`: a board of protocol 1.0 behind the real driver, and a camera without faults."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from drivers import AcquireOptions, LaserBoard, OffFrames, SweepOptions, acquire, prepare, timing
from drivers.arrays import Image
from drivers.board.protocol import BoardFlag, Request
from drivers.cameras.camera import CameraSettings
from drivers.emulator import EmulatedBoard, EmulatedCamera, EmulatedClock, ExposureView, emulated_backend
from drivers.errors import BoardInUse, BoardStalled, BoardTooOld, CameraTimeout, MirrorTimeout

ORDER = [(index, -0.14 + 0.46 * index / 69) for index in range(0, 70, 5)]


def render(view: ExposureView, settings: CameraSettings) -> Image:
    """Image with one bright row that moves with the mirror."""
    image = np.full((256, 96), 40, np.uint8)
    if view.laser_fraction > 0.2:
        row = round(20 + (view.mirror_angle + 0.15) * 400)
        image[row - 1 : row + 2] = 200
    return image


@pytest.fixture
def devices() -> Iterator[tuple[LaserBoard, EmulatedCamera]]:
    """Open board and camera, in emulated time."""
    with timing.on_clock(EmulatedClock()):
        emulated = EmulatedBoard()
        with LaserBoard(backend=emulated_backend(emulated)) as board, EmulatedCamera(emulated, render) as camera:
            yield board, camera


def test_a_scan_is_in_step(devices: tuple[LaserBoard, EmulatedCamera]) -> None:
    """Each stripe is where the mirror points; afterwards the laser is off, and no step is lost."""
    board, camera = devices
    prepare(board, ORDER)
    with acquire(board, camera, ORDER, AcquireOptions(off=OffFrames.ONE)) as stripes:
        rows = [int(stripe.on[:, 0].argmax()) for stripe in stripes if stripe.on is not None]
    assert stripes.report.in_step and len(rows) == len(ORDER) and rows == sorted(set(rows))
    assert prepare(board, ORDER) == 0 and not board.status().laser_sensed


def test_it_is_a_board_of_protocol_1_0(devices: tuple[LaserBoard, EmulatedCamera]) -> None:
    """Sweeps are rejected as by old firmware, and their commands stall."""
    board, camera = devices
    assert board.identity.protocol == (1, 0) and BoardFlag.HAS_SWEEP not in board.status().flags
    camera.triggered = True
    with pytest.raises(BoardTooOld), acquire(board, camera, ORDER, AcquireOptions(sweep=SweepOptions())) as stripes:
        list(stripes)
    with pytest.raises(BoardStalled):
        board.command(Request.SWEEP_PERIOD, 0)


def test_silence_turns_the_laser_off(devices: tuple[LaserBoard, EmulatedCamera]) -> None:
    """The watchdog cuts the supply; the fault is reported and can be cleared."""
    board, _ = devices
    board.laser_on()
    timing.sleep(board.identity.watchdog + 0.05)
    assert not board.status().laser_sensed
    assert not board.clear_faults().faults and board.laser_on().laser_sensed


def test_one_program_uses_the_board() -> None:
    """The interface can be claimed once, and again after closing."""
    backend = emulated_backend(EmulatedBoard())
    with LaserBoard(backend=backend), pytest.raises(BoardInUse), LaserBoard(backend=backend):
        pass
    with LaserBoard(backend=backend) as board:
        assert board.status().step > 0


def test_time_limits_are_kept(devices: tuple[LaserBoard, EmulatedCamera]) -> None:
    """A frame and a motion that take too long raise their own time-out errors."""
    board, camera = devices
    with pytest.raises(CameraTimeout):
        camera.grab(1e-4)
    board.home()
    board.go_to_step(board.identity.max_step, wait=False)
    with pytest.raises(MirrorTimeout):
        board.wait_until_still(timeout=0.0)
