"""State of the emulated board during a camera exposure."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class ExposureView:
    """State of the emulated board during one exposure of a camera.

    Attributes:
        start: start of the exposure [s].
        end: end of the exposure [s].
        laser_fraction: fraction of the exposure during which the laser was on, 0 ... 1.
        mirror_angle: true mirror angle at the middle of the exposure [rad].
        mirror_travel: net rotation of the mirror during the exposure [rad]; the laser plane rotates by twice as much.
    """

    start: float
    end: float
    laser_fraction: float
    mirror_angle: float
    mirror_travel: float
