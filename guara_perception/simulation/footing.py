"""What a planner of strides knows of the ground: where a foot may stand, and how high ground may be that it passes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from guara_perception.arrays import Float, Index, Mask
from guara_perception.terrain.grid import TerrainGrid
from kinematics.transforms import inverse, transform_points

CELL_M = 0.005
# From the body: ground that the next steps can touch [m].
BEFORE_M, BEHIND_M, ASIDE_M = 0.75, 0.55, 0.32
# Half a window over which the highest ground counts for what passes.
WIDE_CELLS = 3
# From here on more distance from bad ground is worth nothing [m].
AMPLE_M = 0.045
# A foot that stands keeps the ground this far around its centre from being higher [m].
UNDER_M = 0.028
# Unknown ground counts as so deep where legs that stand lean over it, which is the planner's own risk [m].
DEEP_M = -1.0


@dataclass(frozen=True)
class Footing:
    """Cells around the body, in a frame with a vertical z axis whose x axis is the way to go.

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

    @classmethod
    def of_map(cls, terrain: TerrainGrid, body: Float, feet: Float, transform_map_to_frame: Float) -> Footing:
        """Ask a map: a foot stands where it allows it, with its own margins, and passes over what it bounds.

        Args:
            terrain: the map.
            body: (3,) place of the body in the frame of the plan [m].
            feet: (n, 3) soles that stand, below which the ground is no higher [m].
            transform_map_to_frame: (4, 4) from base_footprint of the map.
        """
        x, y = around(body)
        places = np.stack([*np.meshgrid(x, y, indexing="ij"), np.zeros((x.size, y.size))], axis=-1)
        rise = transform_map_to_frame[2, 3]
        px, py, _ = np.moveaxis(transform_points(inverse(transform_map_to_frame), places), -1, 0)
        heights, safe = terrain.height_at(px, py), terrain.is_traversable(px, py)
        bound = terrain.highest_at(px, py)
        highest = np.where(np.isnan(bound), np.inf, bound) + rise
        known = np.where(np.isnan(heights), DEEP_M, np.where(np.isnan(bound), heights, bound)) + rise
        for foot in feet:
            under = np.hypot(x[:, None] - foot[0], y - foot[1]) < UNDER_M
            highest[under] = np.minimum(highest[under], foot[2])
        room = np.where(safe, AMPLE_M, 0.0)
        return cls(x, y, heights + rise, safe, room, widened(highest), widened(known))

    def indices(self, x: Float, y: Float) -> tuple[Index, Index]:
        """Of the cells at places, the nearest ones for places outside."""
        i = np.clip(np.rint((x - self.x[0]) / CELL_M), 0, len(self.x) - 1).astype(np.intp)
        j = np.clip(np.rint((y - self.y[0]) / CELL_M), 0, len(self.y) - 1).astype(np.intp)
        return i, j

    def without(self, place: Float, radius: float) -> Footing:
        """The same, but no foot may stand within a radius of a place."""
        far = np.hypot(self.x[:, None] - place[0], self.y - place[1]) > radius
        return replace(self, safe=self.safe & far)


def around(body: Float) -> tuple[Float, Float]:
    """Centres of the cells around a body."""
    x = np.arange(body[0] - BEHIND_M, body[0] + BEFORE_M, CELL_M)
    return x, np.arange(body[1] - ASIDE_M, body[1] + ASIDE_M, CELL_M)


def widened(heights: Float) -> Float:
    """Highest ground near each cell [m]."""
    return np.asarray(ndimage.maximum_filter(heights, size=2 * WIDE_CELLS + 1))
