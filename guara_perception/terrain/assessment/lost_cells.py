"""Cells over which a stripe was fired whose frame was lost: what the fused map knew there holds no longer."""

from __future__ import annotations

import numpy as np

from guara_perception.arrays import Flags, Float, Mask
from guara_perception.terrain.layers.geometry import GridGeometry
from guara_perception.terrain.layers.hazard import Hazard


def lost_cells(
    elevation: Float,
    hazard: Flags,
    in_view: Mask,
    planes_in_footprint: Float,
    is_lost: Mask,
    geometry: GridGeometry,
) -> list[list[int]]:
    """Unknown cells that lie between the neighbours of a lost stripe, at any height that this scan saw.

    Args:
        elevation, hazard: (ny, nx) layers of the scan.
        in_view: (ny, nx) cells that the camera sees if their ground is at z = 0.
        planes_in_footprint: (s, 4) laser planes in the order of the pattern.
        is_lost: (s,) whether a stripe was fired and has no usable frame.
        geometry: the grid.

    Returns:
        Runs [ix, first iy, end iy] of cells, in order: short, as stripes run along y.
    """
    if not is_lost.any():
        return []
    known = np.isfinite(elevation)
    heights = np.append(elevation[known], 0.0)
    x, y = geometry.centres()
    ground = np.column_stack((np.tile(x, y.size), np.repeat(y, x.size)))

    def side(height: float) -> Mask:
        return np.asarray(
            ground @ planes_in_footprint[:, :2].T + planes_in_footprint[:, 2] * height + planes_in_footprint[:, 3] > 0
        )

    low, high = side(float(heights.min())), side(float(heights.max()))
    lost = np.zeros(geometry.size, dtype=bool)
    last = len(planes_in_footprint) - 1
    for stripe in np.flatnonzero(is_lost).tolist():
        before, after = max(stripe - 1, 0), min(stripe + 1, last)
        # Between the two laser planes at the lowest or the highest height, or beyond them on opposite sides.
        lost |= (low[:, before] != low[:, after]) | (high[:, before] != high[:, after])
        lost |= low[:, before] != high[:, before]
    not_looked_at = (hazard & np.uint16(Hazard.UNSCANNED | Hazard.OCCLUDED)) != 0
    return _runs(lost.reshape(geometry.shape) & not_looked_at & in_view)


def _runs(mask: Mask) -> list[list[int]]:
    """Runs of marked cells down each column."""
    padded = np.zeros((mask.shape[1], mask.shape[0] + 2), dtype=np.int8)
    padded[:, 1:-1] = mask.T
    change = np.diff(padded, axis=1)
    column, first = np.nonzero(change == 1)
    _, end = np.nonzero(change == -1)
    return np.column_stack((column, first, end)).tolist()
