"""State of the emulated board at one time and during one exposure."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class BoardView:
    """State of the emulated board at one time.

    Attributes:
        time: the time, on the monotonic clock [s].
        plugged: True if the board is connected now.
        laser_on: True if the laser was on at `time`.
        laser_since: time at which the laser was last switched [s].
        mirror_angle: true mirror angle [rad].
        mirror_angle_commanded: mirror angle assumed by the firmware, which differs after lost steps [rad].
        moving: True if the mirror was moving or settling.
        faults: current fault bits.
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
    """State of the emulated board during one exposure of a camera.

    Attributes:
        start: start of the exposure [s].
        end: end of the exposure [s].
        laser_fraction: fraction of the exposure during which the laser was on, 0 ... 1.
        mirror_angle: true mirror angle at the middle of the exposure [rad].
        mirror_travel: rotation of the mirror during the exposure [rad]; the laser plane rotates by twice as much.
    """

    start: float
    end: float
    laser_fraction: float
    mirror_angle: float
    mirror_travel: float
