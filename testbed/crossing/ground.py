"""What a planner of steps knows of the ground: where a foot may stand, and how high ground may be that it passes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from guara_perception.arrays import Float, Index, Mask

CELL_M = 0.005
# From the body: ground that the next steps can touch [m].
BEFORE_M, BEHIND_M, ASIDE_M = 0.75, 0.45, 0.30
# A true foothold: heights within this radius of it differ by this at most, and it is not in a trench.
SOLE_M, RELIEF_M, DEEPEST_M = 0.020, 0.010, -0.05
# Half a window over which the highest ground counts for what passes.
WIDE_CELLS = 3
# From here on more distance from bad ground is worth nothing [m].
AMPLE_M = 0.045


@dataclass(frozen=True)
class KnownGround:
    """Cells around the body, in the frame in which steps are planned.

    Attributes:
        x, y: centres of the cells [m].
        heights: (nx, ny) ground under a foothold [m].
        safe: (nx, ny) whether a foot may stand there.
        room: (nx, ny) distance of a foothold from what is not safe, as far as the planner should mind [m].
        highest: (nx, ny) highest ground near a cell for a swing; inf where nothing may pass [m].
        shins: (nx, ny) the same for the legs that stand [m].
    """

    x: Float
    y: Float
    heights: Float
    safe: Mask
    room: Float
    highest: Float
    shins: Float

    def indices(self, x: Float, y: Float) -> tuple[Index, Index]:
        """Of the cells at places, the nearest ones for places outside."""
        i = np.clip(np.rint((x - self.x[0]) / CELL_M), 0, len(self.x) - 1).astype(np.intp)
        j = np.clip(np.rint((y - self.y[0]) / CELL_M), 0, len(self.y) - 1).astype(np.intp)
        return i, j

    def without(self, place: Float, radius: float) -> KnownGround:
        """The same, but no foot may stand within a radius of a place where one found nothing."""
        far = np.hypot(self.x[:, None] - place[0], self.y - place[1]) > radius
        return replace(self, safe=self.safe & far)


def around(body: Float) -> tuple[Float, Float]:
    """Centres of the cells around a body."""
    x = np.arange(body[0] - BEHIND_M, body[0] + BEFORE_M, CELL_M)
    return x, np.arange(body[1] - ASIDE_M, body[1] + ASIDE_M, CELL_M)


def of_heights(body: Float, heights: Callable[[Float, Float], Float], deepest: float = DEEPEST_M) -> KnownGround:
    """Ground whose heights are known, or taken to be known, everywhere."""
    x, y = around(body)
    z = heights(*np.meshgrid(x, y, indexing="ij"))
    n = round(SOLE_M / CELL_M)
    disc = np.hypot(*np.mgrid[-n : n + 1, -n : n + 1]) <= n + 0.5
    relief = ndimage.maximum_filter(z, footprint=disc) - ndimage.minimum_filter(z, footprint=disc)
    safe = (relief <= RELIEF_M) & (z > deepest)
    return KnownGround(x, y, z, safe, SOLE_M + room(safe), widened(z), widened(z))


def of_plane(body: Float, feet: Float) -> KnownGround:
    """The plane along the feet (4, 3): all that a blind robot knows."""
    slope = np.linalg.lstsq(np.column_stack((feet[:, :2], np.ones(4))), feet[:, 2])[0]
    return of_heights(body, lambda x, y: slope[0] * x + slope[1] * y + slope[2], -np.inf)


def room(safe: Mask) -> Float:
    """Distance from the nearest cell that is not safe [m]."""
    return np.asarray(ndimage.distance_transform_edt(safe) * CELL_M)


def widened(heights: Float) -> Float:
    """Highest ground near each cell [m]."""
    return np.asarray(ndimage.maximum_filter(heights, size=2 * WIDE_CELLS + 1))
