"""Exposure metering: finds the exposure at which the stripe is bright but not clipped."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from drivers import timing
from drivers.arrays import Image
from drivers.board.board import Board
from drivers.cameras.camera import Camera, CameraSettings
from drivers.errors import CameraError, CameraTimeout, LaserNotSeen
from drivers.sweep.frame_grabber import FrameGrabber
from drivers.sweep.options import AcquireOptions

# Least number of sampled columns, if the image has as many.
SAMPLES = 160


@dataclass(frozen=True, slots=True)
class MeteringResult:
    """Result of exposure metering.

    Attributes:
        exposure: last exposure that was set [s]; None if the exposure was not changed.
        stripe_level: brightness of the stripe's ridge, median over the lit columns, 0 ... 1 of full scale.
        background_level: median brightness with the laser off, 0 ... 1 of full scale.
        clipped_fraction: fraction of the lit columns in which the ridge is clipped.
        settled: True if the brightness of the ridge is within the requested levels.
        advice: what to do if `settled` is False, otherwise empty.
    """

    exposure: float | None
    stripe_level: float
    background_level: float
    clipped_fraction: float
    settled: bool
    advice: str


def meter_exposure(
    board: Board,
    camera: Camera,
    mirror_angle: float,
    *,
    exposure: float | None = None,
    limits: tuple[float, float] = (0.0005, 0.03),
    levels: tuple[float, float] = (0.5, 0.9),
    max_rounds: int = 8,
) -> MeteringResult:
    """Set the exposure so that the ridge brightness of one stripe is within `levels`.

    The laser is off on return, even if an exception is raised.

    Args:
        board: open board, ready for a scan.
        camera: open camera.
        mirror_angle: mirror angle of the stripe [rad], preferably in the middle of the scan.
        exposure: first exposure to try [s]; None = measure without changing the exposure.
        limits: shortest and longest exposure [s].
        levels: lowest and highest brightness of the ridge, 0 ... 1 of full scale.
        max_rounds: largest number of exposures to try.

    Raises:
        ValueError: `limits` or `levels` are not positive and increasing, or `max_rounds` is below 1.
        CameraSettingRefused: the camera rejects an exposure.
        LaserNotSeen: fewer than 2 % of the columns show the laser at the last exposure that was tried.
        CameraTimeout: no frame arrived.
        CameraError: the camera failed, or changed the shape of its images.
        BoardError: the board failed, or the laser is stuck on or dead.
    """
    for name, (low, high) in (("limits", limits), ("levels", levels)):
        if not 0 < low < high:
            raise ValueError(f"{name} are {low} ... {high}; they must increase and be above 0")
    if max_rounds < 1:
        raise ValueError(f"max_rounds is {max_rounds}; allowed: 1 or more")
    grabber = FrameGrabber(camera, board, AcquireOptions())
    board.go_to_angle(mirror_angle)
    held, factor = exposure, 1.0
    for _ in range(max_rounds):
        if held is not None:
            held = camera.lock(CameraSettings(exposure=min(max(held * factor, limits[0]), limits[1]))).exposure
        measured = _measure(board, camera, grabber)
        factor = measured.factor(levels)
        if held is None or factor == 1.0 or _at_limit(held, factor, limits):
            break
    if math.isnan(measured.ridge):
        raise LaserNotSeen(
            "no column of the image shows the laser: is it covered or out of the camera's view, is the exposure "
            f"({'unknown' if held is None else f'{held * 1e3:g} ms'}) too short?"
        )
    settled = measured.factor(levels) == 1.0
    return MeteringResult(
        exposure=held,
        stripe_level=measured.ridge,
        background_level=measured.background,
        clipped_fraction=measured.clipped,
        settled=settled,
        advice="" if settled else _advice(measured, levels),
    )


@dataclass(frozen=True, slots=True)
class _Brightness:
    ridge: float
    background: float
    clipped: float

    def factor(self, levels: tuple[float, float]) -> float:
        """Return the factor by which to change the exposure; 1 if the exposure is right."""
        if math.isnan(self.ridge):
            return 2.0 if self.background < levels[1] else 0.5
        if levels[0] <= self.ridge <= levels[1]:
            return 1.0
        wanted = 0.5 * (levels[0] + levels[1])
        return min(4.0, max(0.25, wanted / max(self.ridge, 1e-3)))


def _measure(board: Board, camera: Camera, grabber: FrameGrabber) -> _Brightness:
    board.laser_off()
    grabber.restart()
    off = grabber.after(timing.monotonic())
    try:
        board.laser_on()
        on = grabber.after(timing.monotonic())
    finally:
        board.laser_off()
    if on is None or off is None:
        raise CameraTimeout(f"{camera.name} delivered no frame while the exposure was metered: check its cable")
    if on.image.shape != off.image.shape:
        raise CameraError(f"{camera.name} changed the shape of its images from {off.image.shape} to {on.image.shape}")
    return brightness_of(on.image, off.image)


def brightness_of(on: Image, off: Image) -> _Brightness:
    """Measure the brightness of ridge and background, and the fraction of lit columns that are clipped."""
    full = float(np.iinfo(on.dtype).max)
    stride = max(1, on.shape[1] // SAMPLES)
    bright, dark = (_strongest(image[:, ::stride]) / full for image in (on, off))
    difference = bright - dark
    rows = difference.argmax(axis=0)[None, :]
    rise = np.take_along_axis(difference, rows, axis=0)[0]
    ridge = np.take_along_axis(bright, rows, axis=0)[0]
    noise = 1.4826 * float(np.median(np.abs(difference - np.median(difference))))
    lit = rise - np.median(difference) > max(0.02, 8.0 * noise)
    background = float(np.median(dark))
    if lit.mean() < 0.02:
        return _Brightness(math.nan, background, 0.0)
    return _Brightness(float(np.median(ridge[lit])), background, float(np.mean(ridge[lit] >= 0.996)))


def _strongest(image: Image) -> np.ndarray:
    values = image.astype(np.float32)
    return values.max(axis=2) if values.ndim == 3 else values


def _at_limit(held: float, factor: float, limits: tuple[float, float]) -> bool:
    return (factor < 1 and held <= limits[0] * 1.01) or (factor > 1 and held >= limits[1] * 0.99)


def _advice(measured: _Brightness, levels: tuple[float, float]) -> str:
    what = f"the stripe's ridge is at {measured.ridge:.2f} of full scale; required: {levels[0]:g} ... {levels[1]:g}"
    if measured.ridge > levels[1] or measured.clipped > 0.5:
        return f"{what}: close the iris, shade the scene, or allow a shorter exposure"
    return f"{what}: open the iris, raise the gain, or allow a longer exposure"
