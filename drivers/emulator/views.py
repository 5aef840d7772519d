"""What the emulated board looks like from outside: at one instant, and over the exposure of a camera."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class BoardView:
    """What the emulated board was like at one instant.

    Attributes:
        time: that instant on the monotonic clock [s].
        plugged: whether the board is on the bus now.
        laser_on: whether the laser really shone.
        laser_since: when the laser last changed [s].
        mirror_angle: where the mirror really was [rad].
        mirror_angle_commanded: where the firmware believed it to be [rad].
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
    """What an exposure of a camera saw of the emulated board.

    Attributes:
        start: beginning of the exposure [s].
        end: its end [s].
        laser_fraction: share of the exposure during which the laser shone, 0 ... 1.
        mirror_angle: true angle at half of the exposure [rad].
        mirror_travel: how far the mirror turned during the exposure [rad]; the laser plane turned twice as far.
    """

    start: float
    end: float
    laser_fraction: float
    mirror_angle: float
    mirror_travel: float
