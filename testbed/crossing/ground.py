"""Footing of a robot that knows the heights, or takes the ground for a plane."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy import ndimage

from guara_perception.arrays import Float, Mask
from guara_perception.simulation.footing import CELL_M, Footing, around, widened

# A true foothold: heights within this radius of it differ by this at most, and it is not in a trench.
SOLE_M, RELIEF_M, DEEPEST_M = 0.020, 0.010, -0.05


def of_heights(
    body: Float, heights: Callable[[Float, Float], Float], deepest: float = DEEPEST_M, sole: Float | None = None
) -> Footing:
    """Ground whose heights are known, or taken to be known, everywhere; for balls of feet, or flat soles (2,) [m]."""
    x, y = around(body)
    z = heights(*np.meshgrid(x, y, indexing="ij"))
    n = round(SOLE_M / CELL_M)
    under = np.hypot(*np.mgrid[-n : n + 1, -n : n + 1]) <= n + 0.5
    if sole is not None:
        under = np.ones(2 * np.ceil(sole / CELL_M / 2).astype(int) + 1, dtype=bool)
    relief = ndimage.maximum_filter(z, footprint=under) - ndimage.minimum_filter(z, footprint=under)
    safe = (relief <= RELIEF_M) & (z > deepest)
    return Footing(x, y, z, safe, SOLE_M + room(safe), widened(z), widened(z))


def of_plane(body: Float, feet: Float) -> Footing:
    """The plane along the feet (4, 3): all that a blind robot knows."""
    slope = np.linalg.lstsq(np.column_stack((feet[:, :2], np.ones(4))), feet[:, 2])[0]
    return of_heights(body, lambda x, y: slope[0] * x + slope[1] * y + slope[2], -np.inf)


def room(safe: Mask) -> Float:
    """Distance from the nearest cell that is not safe [m]."""
    return np.asarray(ndimage.distance_transform_edt(safe) * CELL_M)
