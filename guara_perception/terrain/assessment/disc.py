"""Tests of a cell's neighbourhood: EDGE, clearance."""

from __future__ import annotations

import cv2
import numpy as np

from guara_perception.arrays import Codes, Flags, Float32, Index, Mask
from guara_perception.settings import TraversabilityLimits
from guara_perception.stripes.kernel.library import address, addresses, kernel
from guara_perception.terrain.layers.geometry import (
    EXTRA_RING_CELLS,
    LEAST_MARGIN_CELLS,
    TOUCHED,
    Kernel,
    disc_kernel,
    half_cells,
)
from guara_perception.terrain.layers.hazard import ALL_BUT_EDGE, UNKNOWN_MASK


def step_slope(disc: Kernel) -> float:
    """Slope of the plane fitted to a disc whose two halves differ in height by 1 [1 / cell]."""
    half = disc.shape[0] // 2
    x, columns = np.abs(np.arange(-half, half + 1.0)), disc.sum(axis=0)
    return float(columns @ x / (2 * columns @ x**2))


def edge_cells(
    flags: Flags, disc: Kernel, resolution: float, limits: TraversabilityLimits, drift: Index | None = None
) -> Mask:
    """Mask of the cells on which a sole would cover a hazard, or depend on something unknown or off the grid.

    Every cell under the sole must be free of hazards and known, and every cell that touches the discs of these cells
    must be known, so that no test under the sole depends on an unknown cell. One more ring of cells must be known,
    because heights may change with a neighbouring stripe, and an edge within a cell may show only in the next cell.

    Unknown cells, rises and falls are therefore at least one disc radius away from the sole, and do not get under it
    while the map drifts by no more than this radius. In the map, the sole is widened on each side instead of
    the extra ring, which also keeps it away from hazards: by one cell, so that nothing unsafe reaches its rim, or, if
    more, by the excess of the drift over the disc radius.

    Args:
        flags: (ny, nx) hazard flags.
        disc: disc of the tests.
        resolution: cell edge [m].
        limits: limits of the robot, including the size of its sole.
        drift: (ny, nx, 2) number of cells along y and x by which each cell of the map may have drifted, independently
            of other cells. None for a single scan, which does not drift.
    """
    half = [half_cells(length, resolution) for length in (limits.sole_width, limits.sole_length)]
    bad = ((flags & ALL_BUT_EDGE) != 0).astype(np.uint8)
    unknown = ((flags & UNKNOWN_MASK) != 0).astype(np.uint8)

    def reaches(cells: Codes, area: Codes) -> Codes:
        return np.asarray(cv2.dilate(cells, area, borderType=cv2.BORDER_CONSTANT, borderValue=(1,)))

    def under_sole(cells: Codes, beside: tuple[int, ...]) -> Mask:
        area = np.ones([2 * (n + more) + 1 for n, more in zip(half, beside, strict=True)], np.uint8)
        return np.asarray(reaches(cells, area), dtype=bool)

    read = reaches(unknown, disc_kernel(limits.disc_radius / resolution, TOUCHED))
    if drift is None:
        side = 2 * EXTRA_RING_CELLS + 1
        return under_sole(bad | reaches(read, np.ones((side, side), np.uint8)), (0, 0))
    result = np.zeros(flags.shape, dtype=bool)
    beside = np.maximum(drift - disc.shape[0] // 2, LEAST_MARGIN_CELLS)
    wide = int(beside.max(initial=0)) + 1
    pairs = beside[..., 0] * wide + beside[..., 1]
    for pair in np.flatnonzero(np.bincount(pairs.ravel())).tolist():
        result |= (pairs == pair) & under_sole(bad | read, divmod(pair, wide))
    return result


def clearance(flags: Flags, resolution: float) -> Float32:
    """Signed distance to the nearest cell with a flag other than EDGE, or to the border [m].

    The distance is that of the cell's centre to the nearest point of the other cell. In a cell with such a flag, it is
    negative and measured to the nearest cell without one, or to the border if there is none.
    """
    (ny, nx), flags = flags.shape, np.ascontiguousarray(flags)
    work, found = np.empty((ny + 4) * (nx + 1)), np.empty(flags.shape, np.float32)
    kernel().clearance(address(flags), ny, nx, int(ALL_BUT_EDGE), resolution, *addresses(work, found))
    return found
