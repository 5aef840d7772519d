"""State of the emulated board at one instant, and over the exposure of a camera."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class BoardView:
    """State of the emulated board at one instant.

    Attributes:
        time: that instant on the monotonic clock [s].
        plugged: whether the board is on the bus now.
        laser_on: whether the laser was on.
        laser_since: time of the last change of the laser [s].
        mirror_angle: true mirror angle [rad].
        mirror_angle_commanded: mirror angle in which the firmware believed [rad].
        moving: whether it moved or settled.
        faults: the fault bits now.
    """

    time: float
    plugged: bool
    laser_on: bool
    laser_since: float
    mirror_angle: float
    mirror_angle_commanded: float
    moving: bool
    faults: int


@dataclass(frozen=True, slots=True)
class ExposureView:
    """View of the emulated board by an exposure of a camera.

    Attributes:
        start: beginning of the exposure [s].
        end: its end [s].
        laser_fraction: share of the exposure during which the laser was on, 0 ... 1.
        mirror_angle: true angle at half of the exposure [rad].
        mirror_travel: turn of the mirror during the exposure [rad]; the laser plane turned by twice as much.
    """

    start: float
    end: float
    laser_fraction: float
    mirror_angle: float
    mirror_travel: float
