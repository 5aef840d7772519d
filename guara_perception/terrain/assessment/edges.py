"""How near the edge of safe, known ground a cell is: the EDGE flag and the clearance."""

from __future__ import annotations

import cv2
import numpy as np

from guara_perception.arrays import Codes, Flags, Float, Mask
from guara_perception.settings import TraversabilityLimits
from guara_perception.terrain.assessment.disc import Kernel
from guara_perception.terrain.layers.hazard import ALL_BUT_EDGE, UNKNOWN_MASK

# The value of a cell may change when something is lost beside it, so one more ring must be known.
EXTRA_RING_CELLS = 1


def edge_cells(flags: Flags, kernel: Kernel, resolution: float, limits: TraversabilityLimits) -> Mask:
    """Cells where the sole would cover, or a test would read, something unknown, hazardous or off the grid."""
    half_x = half_cells(limits.sole_length, resolution)
    half_y = half_cells(limits.sole_width, resolution)
    sole = np.ones((2 * half_y + 1, 2 * half_x + 1), np.uint8)
    reach = kernel.shape[0] // 2 + EXTRA_RING_CELLS
    window = np.ones((2 * (half_y + reach) + 1, 2 * (half_x + reach) + 1), np.uint8)
    bad = ((flags & ALL_BUT_EDGE) != 0).astype(np.uint8)
    unknown = ((flags & UNKNOWN_MASK) != 0).astype(np.uint8)

    def reaches(cells: Codes, area: Codes) -> Mask:
        return np.asarray(cv2.dilate(cells, area, borderType=cv2.BORDER_CONSTANT, borderValue=(1,)), dtype=bool)

    return reaches(bad, sole) | reaches(unknown, window)


def clearance(flags: Flags, resolution: float) -> Float:
    """Signed distance to the nearest cell that carries a flag other than EDGE, or to the border [m]; negative inside.

    Distances are from cell centre to the nearer face of the other cell, hence the half cells.
    """
    ny, nx = flags.shape
    bad = (flags & ALL_BUT_EDGE) != 0
    iy, ix = np.arange(ny)[:, None], np.arange(nx)[None, :]
    to_border = np.minimum(np.minimum(iy, ny - 1 - iy), np.minimum(ix, nx - 1 - ix)) + 0.5
    if not bad.any():
        return np.asarray(to_border * resolution)
    if bad.all():
        return np.asarray(-to_border * resolution)
    to_other = _distance_cells(bad) - 0.5
    return np.where(bad, -to_other, np.minimum(to_other, to_border)) * resolution


def half_cells(length: float, resolution: float) -> int:
    """Cells to each side of the centre cell that a sole of this length touches."""
    return int(np.ceil((length / 2 - resolution / 2) / resolution - 1e-9)) if length > resolution else 0


def _distance_cells(mask: Mask) -> Float:
    """From each cell to the nearest one on the other side of the mask, centre to centre."""
    within = mask.astype(np.uint8)
    inside, outside = (cv2.distanceTransform(m, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) for m in (within, 1 - within))
    # One of the two is 0. OpenCV's last bit depends on where the memory lies; the squares are whole numbers, so it can
    # be mended.
    distance = inside + outside
    return np.sqrt(np.rint(distance * distance), dtype=np.float64)
