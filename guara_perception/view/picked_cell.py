"""Where a ray meets a terrain: the point that a click on it chooses."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from guara_perception.arrays import Float
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.view.terrain_mesh import drawn_heights

# A ray is sampled at this share of a cell, up to this distance [m].
SHARE_OF_CELL = 0.5
FAR_M = 20.0
# How far above the highest and below the lowest cell the ray is sampled [m].
MARGIN_M = 0.005


def met_by_ray(terrain: TerrainGrid, origin: npt.ArrayLike, direction: npt.ArrayLike) -> Float | None:
    """The first position (3,) where a ray comes to the drawn terrain or below it, None where it passes by.

    Args:
        terrain: grid; unknown cells are taken as high as they are drawn.
        origin, direction: (3,) in the frame of the grid [m]; the direction of any length.
    """
    start, along = np.asarray(origin, dtype=np.float64), np.asarray(direction, dtype=np.float64)
    along = along / np.linalg.norm(along)
    heights = drawn_heights(terrain)
    near, far = 0.0, FAR_M
    if along[2] != 0.0:
        # Only between the heights of the highest and the lowest cell.
        limits = np.array([heights.max() + MARGIN_M, heights.min() - MARGIN_M])
        one, other = np.sort((limits - start[2]) / along[2])
        near, far = max(near, float(one)), min(far, float(other))
    if far <= near:
        return None
    lengths = np.arange(near, far, SHARE_OF_CELL * terrain.resolution)[:, None]
    points = start + lengths * along
    iy, ix = terrain.geometry.indices(points[:, 0], points[:, 1])
    inside = terrain.geometry.contains(iy, ix)
    met = np.flatnonzero(inside)[points[inside, 2] <= heights[iy[inside], ix[inside]] + 1e-9]
    return points[met[0]] if len(met) else None
