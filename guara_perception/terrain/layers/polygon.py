"""Points and cells against polygons."""

from __future__ import annotations

import numpy as np

from guara_perception.arrays import Float, Index, Mask
from guara_perception.terrain.layers.geometry import GridGeometry


def inside_polygon(corners: Float, x: Float, y: Float) -> Mask:
    """Whether points lie inside a simple polygon, by the number of edges that a ray to the left crosses.

    Args:
        corners: (n, 2), not closed, in either sense of rotation.
        x, y: coordinates of one shape.
    """
    inside = np.zeros(np.shape(x), dtype=bool)
    for (x0, y0), (x1, y1) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        crosses = (y0 > y) != (y1 > y)
        if crosses.any():
            with np.errstate(divide="ignore", invalid="ignore"):
                at = x0 + (y - y0) * (x1 - x0) / (y1 - y0)
            inside ^= crosses & (x < at)
    return inside


def touched_cells(corners: Float, geometry: GridGeometry) -> tuple[Index, Index]:
    """Cells (iy, ix) that a polygon touches, those off the grid among them: none is missed, a few more may be given.

    A cell counts when its centre lies inside, or an edge passes within half its diagonal.
    """
    resolution = geometry.resolution
    low, high = corners.min(axis=0) - resolution, corners.max(axis=0) + resolution
    first = np.floor((low - np.array(geometry.origin)) / resolution).astype(np.int64)
    end = np.ceil((high - np.array(geometry.origin)) / resolution).astype(np.int64) + 1
    ix, iy = np.meshgrid(np.arange(first[0], end[0]), np.arange(first[1], end[1]))
    x = geometry.origin[0] + (ix + 0.5) * resolution
    y = geometry.origin[1] + (iy + 0.5) * resolution
    touched = inside_polygon(corners, x, y)
    for start, stop in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        touched |= distance_to_segment(start, stop, x, y) <= resolution * np.sqrt(0.5) + 1e-9
    return iy[touched], ix[touched]


def distance_to_segment(start: Float, stop: Float, x: Float, y: Float) -> Float:
    """Distance of points from a line segment, all in the plane."""
    along = stop - start
    length = float(along @ along)
    share = np.zeros(np.shape(x)) if length == 0 else ((x - start[0]) * along[0] + (y - start[1]) * along[1]) / length
    share = np.clip(share, 0.0, 1.0)
    return np.asarray(np.hypot(x - start[0] - share * along[0], y - start[1] - share * along[1]))
