"""The list of stripes of a scan: which index at which mirror angle, and in which order."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from drivers.errors import BadPattern


@dataclass(frozen=True, slots=True)
class PatternStripe:
    """One stripe to be taken: its index in the standard pattern and the mirror angle [rad]."""

    index: int
    mirror_angle: float


# Image rows (first, end) between which a stripe must appear.
RowRange = tuple[int, int]
# The row range of a stripe by its index; it follows from a calibration.
RowRangeOf = Callable[[int], RowRange]


def check_pattern(pattern: Iterable[tuple[int, float]]) -> tuple[PatternStripe, ...]:
    """The pattern as a tuple.

    Args:
        pattern: pairs (index, mirror angle [rad]) in the order in which they are to be taken.

    Raises:
        BadPattern: empty, an index twice or negative, an angle not finite.
    """
    stripes = tuple(PatternStripe(int(index), float(angle)) for index, angle in pattern)
    if not stripes:
        raise BadPattern("the pattern holds no stripe, at least one is needed")
    seen: set[int] = set()
    for stripe in stripes:
        if stripe.index < 0 or stripe.index in seen:
            raise BadPattern(f"stripe index {stripe.index} in the pattern: each must be 0 or more, and come once")
        if not math.isfinite(stripe.mirror_angle):
            raise BadPattern(f"stripe {stripe.index} has mirror angle {stripe.mirror_angle}, it must be finite")
        seen.add(stripe.index)
    return stripes
