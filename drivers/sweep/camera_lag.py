"""Measurement of a camera's lag.

The lag is the age of the oldest light in a frame, apart from at most a tenth of the light, at the time of the stamp.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from drivers import timing
from drivers.arrays import Float32, Image
from drivers.board.board import Board
from drivers.cameras.camera import Camera
from drivers.errors import CameraTimeout, LaserNotSeen, StripeClipped
from drivers.frame import Frame

# A frame with at least this fraction of the laser's light counts as lit; one with at most 1 - FULL of it counts as
# dark.
FULL = 0.9
GOLDEN = 0.618034
# Largest allowed fraction of clipped pixels in the stripe.
MAX_CLIPPED = 0.1
# Number of frames after which the pipeline of any camera shows the new state of the laser.
SETTLE_FRAMES = 6
# Number of frames without the expected change after which the measurement fails.
MOST_FRAMES = 20


@dataclass(frozen=True, slots=True)
class LagMeasurement:
    """Measured lag of a camera.

    Attributes:
        lag: upper bound of the lag [s]. In a frame with stamp t, at most a tenth of the laser light was received
            before t - lag.
        uncertainty: width of the measured interval [s]; the true lag is between lag - uncertainty and lag.
        period: time between frames [s].
    """

    lag: float
    uncertainty: float
    period: float


def measure_lag(board: Board, camera: Camera, *, toggles: int = 24, timeout: float = 1.0) -> LagMeasurement:
    """Measure a camera's lag by switching the laser at different phases of the frame period.

    This function does not set `camera.lag`; set it to the `lag` of the result. Meter the exposure first, so that the
    stripe is not clipped. The laser is off on return, even if an exception is raised.

    Args:
        board: open board with the mirror at rest, at an angle at which the camera sees the stripe.
        camera: open camera.
        toggles: number of times that the laser is switched, at least 4; a larger number reduces the uncertainty.
        timeout: longest wait for a frame [s].

    Raises:
        ValueError: `toggles` is too small.
        LaserNotSeen: the frames do not depend on the laser, or contradict each other.
        StripeClipped: the stripe is too bright to distinguish a partial exposure from a full one.
        CameraTimeout: no frame arrived, or stamps or frame counters do not increase.
        CameraError: the camera failed.
        BoardError: the board failed, or the laser is stuck on or dead.
    """
    if toggles < 4:
        raise ValueError(f"toggles is {toggles}; allowed: at least 4")
    shortest, longest = 0.0, math.inf
    try:
        board.laser_off()
        dark, _ = _settled(board, camera, timeout)
        board.laser_on()
        lit, period = _settled(board, camera, timeout)
        share = _laser_share(dark.image, lit.image)
        on = True
        for turn in range(toggles):
            on = not on
            # Multiples of the golden ratio distribute the switchings evenly over the period.
            timing.sleep(turn * GOLDEN % 1.0 * period)
            board.status()
            before = timing.monotonic()
            board.laser_on() if on else board.laser_off()
            after = timing.monotonic()
            for _ in range(MOST_FRAMES):
                frame = camera.grab(timeout)
                board.status()
                value = share(frame.image) if on else 1.0 - share(frame.image)
                if frame.stamp <= before:
                    continue
                if value >= FULL:
                    longest = min(longest, max(0.0, frame.stamp - before))
                    break
                shortest = max(shortest, frame.stamp - after)
            else:
                raise LaserNotSeen(
                    f"{MOST_FRAMES} frames after the laser was switched {'on' if on else 'off'}, "
                    f"{camera.name} still does not show the change: does anything else light the scene?"
                )
    finally:
        board.laser_off()
    if longest < shortest:
        raise LaserNotSeen(
            f"{camera.name}: the frames contradict each other by {(shortest - longest) * 1e3:.1f} ms: one showed a "
            "change of the laser that another, longer after its change, did not show: is the stripe clipped, or does "
            "anything else light the scene?"
        )
    return LagMeasurement(longest, longest - shortest, period)


def _laser_share(dark: Image, lit: Image) -> Callable[[Image], float]:
    """Make the function that returns the fraction of the laser's light in an image: 0 for `dark`, 1 for `lit`."""
    dark_values = _flat(dark)
    difference = _flat(lit) - dark_values
    noise = 1.4826 * float(np.median(np.abs(difference - np.median(difference))))
    full = float(np.iinfo(lit.dtype).max)
    threshold = max(0.05 * full, 8.0 * noise, 0.3 * float(difference.max(initial=0.0)))
    stripe = np.nonzero(difference > threshold)
    brightest = lit.max(axis=2) if lit.ndim == 3 else lit
    clipped = float(np.mean(brightest[stripe] >= 0.99 * full)) if len(stripe[0]) else 0.0
    if clipped > MAX_CLIPPED:
        raise StripeClipped(
            f"{clipped:.0%} of the stripe is clipped; allowed: at most {MAX_CLIPPED:.0%}: call meter_exposure() "
            "first, so that a partial exposure can be distinguished from a full one"
        )
    if len(stripe[0]) < difference.shape[1] // 50 + 1:
        raise LaserNotSeen(
            "images with the laser on and off do not differ: is the laser covered or out of the camera's view?"
        )
    whole = float(difference[stripe].sum())
    return lambda image: float((_flat(image) - dark_values)[stripe].sum()) / whole


def _flat(image: Image) -> Float32:
    values = image.astype(np.float32)
    return values.sum(axis=2) if values.ndim == 3 else values


def _settled(board: Board, camera: Camera, timeout: float) -> tuple[Frame, float]:
    camera.flush()
    frames = []
    for _ in range(SETTLE_FRAMES):
        frames.append(camera.grab(timeout))
        board.status()
    span = frames[-1].stamp - frames[0].stamp
    count = frames[-1].counter - frames[0].counter
    if span <= 0 or count <= 0:
        raise CameraTimeout(
            f"stamps or counters of the frames of {camera.name} do not increase: use a live camera, not a replay"
        )
    return frames[-1], span / count
