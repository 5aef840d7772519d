"""Flags of the cells that a sole would cover, for many positions at once."""

from __future__ import annotations

import numpy as np

from guara_perception.arrays import Flags, Float, Index
from guara_perception.settings import TraversabilityLimits
from guara_perception.terrain.layers.geometry import GridGeometry
from guara_perception.terrain.layers.hazard import Hazard

# Positions that are computed together: keeps the memory small for whole grids of positions.
CHUNK = 4096
# A sole that only shares an edge with a cell does not cover it.
TOLERANCE_CELLS = 1e-6


def sole_flags(hazard: Flags, geometry: GridGeometry, x: Float, y: Float, limits: TraversabilityLimits) -> Flags:
    """Union of the flags of all cells that the sole rectangle, aligned with x, covers wholly or partly.

    Args:
        hazard: (ny, nx).
        geometry: geometry of the grid.
        x, y: (n,) sole centres, finite.
        limits: limits of the robot, with the sole's size.

    Returns:
        (n,) uint16; a sole that reaches off the grid has UNSCANNED among its flags.
    """
    result = np.empty(x.size, dtype=np.uint16)
    for start in range(0, x.size, CHUNK):
        part = slice(start, start + CHUNK)
        columns = _covered(x[part], geometry.origin[0], limits.sole_length, geometry.resolution)
        rows = _covered(y[part], geometry.origin[1], limits.sole_width, geometry.resolution)
        ny, nx = geometry.shape
        outside = ((columns < 0) | (columns >= nx)).any(axis=1) | ((rows < 0) | (rows >= ny)).any(axis=1)
        columns, rows = np.clip(columns, 0, nx - 1), np.clip(rows, 0, ny - 1)
        cells = hazard.ravel()[(rows * nx)[:, :, None] + columns[:, None, :]]
        flags = np.bitwise_or.reduce(cells.reshape(len(cells), -1), axis=1)
        result[part] = flags | np.where(outside, np.uint16(Hazard.UNSCANNED), 0).astype(np.uint16)
    return result


def sole_window(
    geometry: GridGeometry, x: float, y: float, limits: TraversabilityLimits
) -> tuple[slice, slice, int, int]:
    """Rows and columns of the cells on the grid that one sole covers, how many it covers, and how many are off it."""
    columns = np.unique(_covered(np.array([x]), geometry.origin[0], limits.sole_length, geometry.resolution))
    rows = np.unique(_covered(np.array([y]), geometry.origin[1], limits.sole_width, geometry.resolution))
    ny, nx = geometry.shape
    on_x, on_y = columns[(columns >= 0) & (columns < nx)], rows[(rows >= 0) & (rows < ny)]
    total, on = columns.size * rows.size, on_x.size * on_y.size
    if not on:
        return slice(0, 0), slice(0, 0), total, total
    return slice(int(on_y[0]), int(on_y[-1]) + 1), slice(int(on_x[0]), int(on_x[-1]) + 1), total, total - on


def _covered(centre: Float, origin: float, length: float, resolution: float) -> Index:
    """Cell indices (n, w) along one axis; where a sole covers fewer than w the last one is repeated."""
    at = (centre - origin) / resolution
    half = length / 2 / resolution
    # Far off the grid is off the grid: no overflow for absurd positions.
    first = np.clip(np.floor(at - half + TOLERANCE_CELLS), -(2**31), 2**31).astype(np.int64)
    last = np.clip(np.ceil(at + half - TOLERANCE_CELLS) - 1, -(2**31), 2**31).astype(np.int64)
    last = np.maximum(last, first)
    width = int((last - first).max()) + 1 if first.size else 1
    return np.minimum(first[:, None] + np.arange(width), last[:, None])
