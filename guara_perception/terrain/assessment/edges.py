"""How near the edge of safe, known ground a cell is: the EDGE flag and the clearance."""

from __future__ import annotations

import cv2
import numpy as np

from guara_perception.arrays import Codes, Flags, Float, Index, Mask
from guara_perception.settings import TraversabilityLimits
from guara_perception.terrain.assessment.disc import Kernel, touched_kernel
from guara_perception.terrain.layers.hazard import ALL_BUT_EDGE, UNKNOWN_MASK

# A height of a single scan may change when a stripe beside it is lost, so one more ring must be known.
EXTRA_RING_CELLS = 1
# The sole in the fused map is wider by at least this [cells].
LEAST_MARGIN_CELLS = 1
# Largest drift of the fused map that is considered [cells]; more makes no difference.
LARGEST_DRIFT_CELLS = 6


def edge_cells(
    flags: Flags, kernel: Kernel, resolution: float, limits: TraversabilityLimits, drift: Index | None = None
) -> Mask:
    """Cells where the sole would cover, or a test would read, something unknown, hazardous or off the grid.

    Every cell under the sole must be free of hazards, and all that its tests read (its disc) be known: then no test
    under the sole depends on anything that is not known. The window is exactly that, corners rounded as the disc is.

    So whatever is unknown, rises or falls is at least a disc's radius away from the sole, and the map may have drifted
    by that much before it comes under the sole. In the map the sole is also widened by one cell, so that nothing unsafe
    comes under its rim while the drift is no larger; where a cell may have drifted by more than the disc's radius, the
    sole is widened by the rest if that is more than one cell. Unknown cells and hazards are kept away alike: what is
    unknown might turn out to be a hazard.

    Args:
        flags: (ny, nx).
        kernel: the disc of the tests.
        resolution: cell edge [m].
        limits: limits of the robot, with the sole's size.
        drift: (ny, nx, 2) number of cells along y and x by which each cell may have drifted, a property of that cell
            alone (the fused map). None: a single scan, where nothing has drifted, but heights may change
            with the stripe beside them and an edge that runs through a cell may show in the next one: all cells that
            the discs touch must be known, and one ring more around them.
    """
    half = [half_cells(length, resolution) for length in (limits.sole_width, limits.sole_length)]
    bad = ((flags & ALL_BUT_EDGE) != 0).astype(np.uint8)
    unknown = ((flags & UNKNOWN_MASK) != 0).astype(np.uint8)

    def reaches(cells: Codes, area: Codes) -> Codes:
        return np.asarray(cv2.dilate(cells, area, borderType=cv2.BORDER_CONSTANT, borderValue=(1,)))

    def under_sole(cells: Codes, beside: tuple[int, ...]) -> Mask:
        area = np.ones([2 * (n + more) + 1 for n, more in zip(half, beside, strict=True)], np.uint8)
        return np.asarray(reaches(cells, area), dtype=bool)

    if drift is None:
        side = 2 * EXTRA_RING_CELLS + 1
        read = reaches(unknown, touched_kernel(limits.disc_radius / resolution))
        return under_sole(bad | reaches(read, np.ones((side, side), np.uint8)), (0, 0))
    read = reaches(unknown, kernel)
    result = np.zeros(flags.shape, dtype=bool)
    beside = np.maximum(drift - kernel.shape[0] // 2, LEAST_MARGIN_CELLS)
    wide = int(beside.max(initial=0)) + 1
    pairs = beside[..., 0] * wide + beside[..., 1]
    for pair in np.flatnonzero(np.bincount(pairs.ravel())).tolist():
        result |= (pairs == pair) & under_sole(bad | read, divmod(pair, wide))
    return result


def beyond_border(kernel: Kernel) -> int:
    """Number of rows and columns beyond the border of the fused map that influence whether a sole on it is safe."""
    return kernel.shape[0] // 2 + _most_beside(kernel)


def _most_beside(kernel: Kernel) -> int:
    """Cells by which a sole in the map is wider on each side at most."""
    return max(LARGEST_DRIFT_CELLS - kernel.shape[0] // 2, LEAST_MARGIN_CELLS)


def widest_window(kernel: Kernel, resolution: float, limits: TraversabilityLimits, *, is_map: bool) -> float:
    """Distance from the centre of a cell to the farthest corner of what `edge_cells` reads around it [m]."""
    half_y, half_x = (half_cells(length, resolution) for length in (limits.sole_width, limits.sole_length))
    iy, ix = np.nonzero(kernel if is_map else touched_kernel(limits.disc_radius / resolution))
    radius = kernel.shape[0] // 2
    more = _most_beside(kernel) if is_map else EXTRA_RING_CELLS
    reach_y, reach_x = np.abs(iy - radius) + more, np.abs(ix - radius) + more
    return float(np.hypot(half_y + reach_y + 0.5, half_x + reach_x + 0.5).max()) * resolution


def clearance(flags: Flags, resolution: float) -> Float:
    """Signed distance to the nearest cell that carries a flag other than EDGE, or to the border [m]; negative inside.

    Distances are from cell centre to the nearer face of the other cell, which explains the half cells.
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
    """Distance from each cell to the nearest one on the other side of the mask, centre to centre [cells]."""
    within = mask.astype(np.uint8)
    inside, outside = (cv2.distanceTransform(m, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) for m in (within, 1 - within))
    # One of the two is 0. OpenCV's last bit depends on where the memory lies; since the squares are whole numbers,
    # rounding corrects it.
    distance = inside + outside
    return np.sqrt(np.rint(distance * distance), dtype=np.float64)
