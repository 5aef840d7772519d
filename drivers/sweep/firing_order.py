"""Firing order of a scan: stripe indices with their mirror angles, in the order of scanning."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from drivers.errors import BadFiringOrder


@dataclass(frozen=True, slots=True)
class PlannedStripe:
    """Stripe of a firing order: index in the standard pattern, and mirror angle [rad]."""

    index: int
    mirror_angle: float


# Image rows (first, end) in which a stripe must appear.
RowRange = tuple[int, int]
# Function that returns the row range of a stripe, computed from a calibration, given the index of the stripe.
RowRangeOf = Callable[[int], RowRange]


def check_firing_order(firing_order: Iterable[tuple[int, float]]) -> tuple[PlannedStripe, ...]:
    """Check a firing order, and return it as a tuple.

    Args:
        firing_order: pairs (index, mirror angle [rad]) in the order of scanning.

    Raises:
        BadFiringOrder: the order is empty, an index is repeated or negative, or an angle is not finite.
    """
    stripes = tuple(PlannedStripe(int(index), float(angle)) for index, angle in firing_order)
    if not stripes:
        raise BadFiringOrder("the firing order is empty; allowed: at least one stripe")
    seen: set[int] = set()
    for stripe in stripes:
        if stripe.index < 0 or stripe.index in seen:
            raise BadFiringOrder(
                f"stripe index {stripe.index} in the firing order; each index must be 0 or more and occur once"
            )
        if not math.isfinite(stripe.mirror_angle):
            raise BadFiringOrder(f"stripe {stripe.index} has mirror angle {stripe.mirror_angle}; it must be finite")
        seen.add(stripe.index)
    return stripes
