"""Sweeps with emulated devices in emulated time: triggered by the emulated board or chip, or free-running."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers import (
    AcquireOptions,
    BoardConfig,
    Image,
    LaserBoard,
    StripeCapture,
    SweepOptions,
    acquire,
    prepare,
    timing,
)
from drivers.cameras.camera import Camera, CameraSettings
from drivers.emulator import EmulatedBackend, EmulatedClock, EmulatorConfig, ExposureView
from testbed.bench_board import BenchBoard, BenchCamera, bench_backend
from testbed.scenes import ScanInMemory
from testbed.triggered_camera import EmulatedTriggeredCamera

# Duration of the laser flash of a stripe [s].
FLASH = 0.004
# Duration of a transfer to the emulated board, as on a full-speed bus [s].
BUS_DELAY = 0.0003
FIRMWARE = Path(__file__).resolve().parents[1] / "firmware" / "guara_board.uf2"


def firing_order_of(stripes: int) -> list[tuple[int, float]]:
    """Pairs (index, mirror angle) of stripes that are evenly chosen from the 70 of the standard pattern."""
    stride = 70 // stripes
    return [(index, -0.14 + 0.46 * index / 69) for index in range(0, 70, stride)]


class Picture:
    """Renderer of small images of a laser line, whose first two pixels contain the number of the exposure."""

    def __init__(self, board: BenchBoard | None = None) -> None:
        """Create the renderer; exposures are numbered only if a `board` is given."""
        self._board = board
        self._number = 0

    def __call__(self, view: ExposureView, settings: CameraSettings) -> Image:
        """Render an exposure."""
        image = np.full((256, 80, 3), 40, np.uint8)
        if view.laser_fraction > 0.2:
            row = 20 + round((view.mirror_angle + 0.15) * 400)
            image[max(0, row - 1) : row + 2, :, 2] = 200
        if self._board is not None:
            starts = [opening[0] for opening in self._board.openings(self._number)]
            self._number += starts.index(view.start)
            image[0, :2, 0] = divmod(self._number, 256)
        return image


def view_of(scan: ScanInMemory) -> Callable[[ExposureView, CameraSettings], Image]:
    """Create a renderer that returns the frame of a scan whose mirror angle is nearest, with or without the laser."""
    angles = {stripe.index: stripe.mirror_angle for stripe in scan.calibration.stripes}
    mirror_angles = np.array([angles[index] for index, _, _ in scan.frames])

    def render(view: ExposureView, settings: CameraSettings) -> Image:
        _, on, off = scan.frames[int(np.argmin(np.abs(mirror_angles - view.mirror_angle)))]
        return on if view.laser_fraction > 0.5 else off

    return render


@contextmanager
def emulated(config: EmulatorConfig | None = None) -> Iterator[tuple[BenchBoard, LaserBoard]]:
    """Yield an emulated board in emulated time, and the driver connected to it."""
    with timing.on_clock(EmulatedClock()):
        board = BenchBoard(config)
        board.bus_delay = BUS_DELAY if config is None else 0.0
        with LaserBoard(BoardConfig(handle_signals=False), backend=bench_backend(board)) as driver:
            yield board, driver


def bound_of(driver: LaserBoard, firing_order: list[tuple[int, float]], flash: float) -> float:
    """Lower bound of the duration of moves, settling and flashes, by the board's motion profile [s]."""
    motion_profile = driver.motion_profile()
    steps = [driver.step_at(angle) for _, angle in firing_order]
    moves = sum(motion_profile.time(after - before) for before, after in zip(steps, steps[1:], strict=False))
    return moves + len(steps) * (motion_profile.settle + flash)


def take(
    driver: LaserBoard, camera: Camera, firing_order: list[tuple[int, float]], options: AcquireOptions
) -> list[StripeCapture]:
    """Acquire one scan, after moving the mirror to the first stripe."""
    prepare(driver, firing_order)
    with camera, acquire(driver, camera, firing_order, options) as stripes:
        return list(stripes)


@dataclass(frozen=True, slots=True)
class Triggered:
    """Result of a triggered sweep.

    Attributes:
        stripes: number of stripes.
        flash: duration of each flash [s].
        seconds: time from the first trigger to the end of the last flash [s].
        bound: lower bound of the time for motion and flashes [s].
        proved: number of stripes whose frames were verified.
    """

    stripes: int
    flash: float
    seconds: float
    bound: float
    proved: int


def triggered(stripes: int, flash: float = FLASH, fps: float = 0.0) -> Triggered:
    """Sweep with the emulated board and a camera of at most `fps` frames per second; 0 = no limit."""
    firing_order = firing_order_of(stripes)
    with emulated() as (board, driver):
        board.shutter.wired, board.shutter.exposure = True, flash
        camera = EmulatedTriggeredCamera(board, board.shutter, Picture(), fps=fps)
        taken = take(driver, camera, firing_order, AcquireOptions(sweep=SweepOptions(flash=flash)))
        bound = bound_of(driver, firing_order, flash)
        return _result(stripes, flash, np.array(board.triggers()), bound, taken)


def triggered_on_chip(stripes: int, flash: float = FLASH) -> Triggered:
    """Sweep with the firmware on the emulated chip, which ramps the motor; needs the extra `firmware`."""
    from testbed.chip import Chip, ChipBus, ChipClock, load_firmware

    firing_order = firing_order_of(stripes)
    chip = Chip(load_firmware(FIRMWARE))
    chip.wiring.shutter.wired, chip.wiring.shutter.exposure = True, flash
    chip.rewire()
    bus = ChipBus(chip)
    with (
        ChipClock(bus),
        LaserBoard(BoardConfig(handle_signals=False), backend=EmulatedBackend(bus)) as driver,
    ):
        camera = EmulatedTriggeredCamera(bus, chip.wiring.shutter, Picture())
        taken = take(driver, camera, firing_order, AcquireOptions(sweep=SweepOptions(flash=flash)))
        return _result(
            stripes, flash, np.array(chip.world.triggers) / 1e9, bound_of(driver, firing_order, flash), taken
        )


def _result(stripes: int, flash: float, triggers: np.ndarray, bound: float, taken: list[StripeCapture]) -> Triggered:
    proved = sum(stripe.on is not None and stripe.verdict.in_step for stripe in taken)
    return Triggered(stripes, flash, float(triggers[-1] - triggers[0] + flash), bound, proved)


def free_running(fps: int, stripes: int) -> float:
    """Duration of a sweep with a free-running camera, from the first command to the last frame [s]."""
    firing_order = firing_order_of(stripes)
    exposure = min(0.008, 0.4 / fps)
    with emulated() as (board, driver):
        camera = BenchCamera(board, Picture(), fps=fps, exposure=exposure, latency=exposure)
        prepare(driver, firing_order)
        with camera, acquire(driver, camera, firing_order) as stripes_taken:
            count = sum(1 for _ in stripes_taken)
        assert count == stripes
        return stripes_taken.report.duration
