"""Footing on ground with known heights, or on the plane through the feet."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy import ndimage

from guara_perception.arrays import Float, Mask
from guara_perception.simulation.footing import CELL_M, Footing, around, widened

# Radius of a sole, largest height difference below it, and lowest height of a foothold, which excludes trenches [m].
SOLE_M, RELIEF_M, DEEPEST_M = 0.020, 0.010, -0.05


def of_heights(
    body: Float, heights: Callable[[Float, Float], Float], deepest: float = DEEPEST_M, sole: Float | None = None
) -> Footing:
    """Create the footing on ground of known heights, for ball feet or flat soles.

    Args:
        body: (3,) position of the body [m].
        heights: function that returns the heights at points x, y [m].
        deepest: lowest height of a foothold [m].
        sole: (2,) length and width of flat soles [m]; None = ball feet.
    """
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
    """Create the footing on the plane through the feet (4, 3), which a blind robot assumes."""
    slope = np.linalg.lstsq(np.column_stack((feet[:, :2], np.ones(4))), feet[:, 2])[0]
    return of_heights(body, lambda x, y: slope[0] * x + slope[1] * y + slope[2], -np.inf)


def room(safe: Mask) -> Float:
    """Distance of each cell from the nearest unsafe cell [m]."""
    return np.asarray(ndimage.distance_transform_edt(safe) * CELL_M)
