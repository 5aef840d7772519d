"""The result of finding one laser stripe in one picture: a position, a sigma and a status per column."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from guara_perception.arrays import Codes, Float32
from kinematics.arrays import read_only


class StripeStatus(IntEnum):
    """What happened in one column; the values never change."""

    OK = 0
    DROPOUT = 1
    AMBIGUOUS = 2
    SATURATED = 3
    MIXED_EDGE = 4
    OUT_OF_BAND = 5
    FRAME_BAD = 6


@dataclass(frozen=True, slots=True)
class StripeProfile:
    """One stripe, column by column (row by row when it was extracted along rows).

    Attributes:
        position_px: (n,) float32, row of the stripe centre in full-picture coordinates, NaN where there is none.
        sigma_px: (n,) float32, standard deviation of the position, NaN where there is none.
        status: (n,) uint8, a StripeStatus per column.
        peak: (n,) float32, height of the smoothed peak above background [grey levels], NaN in a bad frame.
        doubtful_px: (n,) float32, row of a return that may not be used (ambiguous or mixed), NaN where there is none.
        reason: why the whole frame is bad, empty when it is not.
        remark: why the laser-off picture was not used, empty when it was or there was none.
    """

    position_px: Float32
    sigma_px: Float32
    status: Codes
    peak: Float32
    doubtful_px: Float32
    reason: str = ""
    remark: str = ""

    def __post_init__(self) -> None:
        for name in ("position_px", "sigma_px", "status", "peak", "doubtful_px"):
            object.__setattr__(self, name, read_only(getattr(self, name)))

    @property
    def is_frame_bad(self) -> bool:
        """Whether the whole frame was refused."""
        return bool(self.reason)

    def mirrored(self) -> StripeProfile:
        """The profile of the same picture seen in a mirror, its columns in reverse order."""
        return StripeProfile(
            self.position_px[::-1],
            self.sigma_px[::-1],
            self.status[::-1],
            self.peak[::-1],
            self.doubtful_px[::-1],
            self.reason,
        )


def bad_frame(n: int, reason: str) -> StripeProfile:
    """The profile of a frame that cannot be used: nothing is known but the reason."""
    status = np.full(n, StripeStatus.FRAME_BAD, dtype=np.uint8)
    return StripeProfile(nothing(n), nothing(n), status, nothing(n), nothing(n), reason)


def nothing(n: int) -> Float32:
    """NaN (n,) read-only, in the memory of one number: a scan keeps the profiles of all its stripes."""
    one = np.full((), np.nan, dtype=np.float32)
    one.setflags(write=False)
    return np.broadcast_to(one, n)
