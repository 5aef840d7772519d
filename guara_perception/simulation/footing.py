"""Ground around the body for a stride planner: where a foot may stand, and how high the ground may be below a path."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from guara_perception.arrays import Float, Index, Mask
from guara_perception.terrain.grid import TerrainGrid
from kinematics.transforms import inverse, transform_points

CELL_M = 0.005
# Extent of the ground around the body that the next steps can reach: ahead, behind, and to each side [m].
BEFORE_M, BEHIND_M, ASIDE_M = 0.75, 0.55, 0.32
# Half the width of the window from which a cell takes its highest ground, for swings and legs [cells].
WIDE_CELLS = 3
# Distance from unsafe ground above which a foothold does not improve further [m].
AMPLE_M = 0.045
# Radius around the centre of a standing sole within which the ground cannot be higher than the sole [m].
UNDER_M = 0.028
# Assumed height of unknown ground below standing legs that lean over it [m]; the planner accepts this risk.
DEEP_M = -1.0


@dataclass(frozen=True)
class Footing:
    """Cells around the body, in a frame whose z axis is vertical and whose x axis is the direction of travel.

    Attributes:
        x, y: centres of the cells [m].
        heights: (nx, ny) ground under a foothold [m].
        safe: (nx, ny) mask of the cells in which a foot may stand.
        room: (nx, ny) distance of a foothold from unsafe ground, at most AMPLE_M [m].
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
        """Create from a map. A foot may stand on traversable cells, and pass over cells with an upper bound of height.

        Args:
            terrain: the map.
            body: (3,) position of the body in the frame of the plan [m].
            feet: (n, 3) centres of the standing soles, which bound the ground below them [m].
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
        """Indices (i, j) of the cells at positions; the nearest cells for positions outside."""
        i = np.clip(np.rint((x - self.x[0]) / CELL_M), 0, len(self.x) - 1).astype(np.intp)
        j = np.clip(np.rint((y - self.y[0]) / CELL_M), 0, len(self.y) - 1).astype(np.intp)
        return i, j

    def without(self, place: Float, radius: float) -> Footing:
        """Copy in which no foot may stand within a radius of a position."""
        far = np.hypot(self.x[:, None] - place[0], self.y - place[1]) > radius
        return replace(self, safe=self.safe & far)


def around(body: Float) -> tuple[Float, Float]:
    """Centres of the cells around a body."""
    x = np.arange(body[0] - BEHIND_M, body[0] + BEFORE_M, CELL_M)
    return x, np.arange(body[1] - ASIDE_M, body[1] + ASIDE_M, CELL_M)


def widened(heights: Float) -> Float:
    """Highest ground near each cell [m]."""
    return np.asarray(ndimage.maximum_filter(heights, size=2 * WIDE_CELLS + 1))
