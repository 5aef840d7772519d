"""Windows of the tests of a cell: the disc around it, and the sole on it; without OpenCV, which guara-client lacks."""

from __future__ import annotations

import numpy as np

from guara_perception.arrays import Codes
from guara_perception.exceptions import InvalidInput
from guara_perception.settings import TraversabilityLimits

Kernel = Codes
# Least known fraction of a disc for a plane fit; EDGE decides if the cell is safe.
KNOWN_SHARE = 0.6
# Largest radius of the disc; a finer grid gains nothing over the stripe pitch.
MOST_RADIUS_CELLS = 24
# A height of a single scan may change if a stripe beside it is lost, so one more ring must be known.
EXTRA_RING_CELLS = 1
# Half edge of a cell [cells].
TOUCHED = 0.5
# The sole in the fused map is wider by at least this [cells].
LEAST_MARGIN_CELLS = 1
# Largest drift of the fused map that is considered [cells]; more makes no difference.
LARGEST_DRIFT_CELLS = 6


def disc_kernel(radius_cells: float, half_cell: float = 0.0) -> Kernel:
    """Disc of cells whose centres lie within the radius, (2 r + 1, 2 r + 1) uint8.

    It contains at least the four neighbours: a slope cannot be tested with one cell.

    Args:
        radius_cells: radius [cells].
        half_cell: half edge of a square about each centre; the cell counts if any part of the square lies within the
            radius. 0 = the centre alone, TOUCHED = the whole cell.

    Raises:
        InvalidInput: the disc is larger than MOST_RADIUS_CELLS cells.
    """
    if not radius_cells < MOST_RADIUS_CELLS + 1:
        raise InvalidInput(
            f"the disc's radius is {radius_cells:.0f} cells, at most {MOST_RADIUS_CELLS} are allowed: "
            "take a larger resolution or a smaller disc_radius"
        )
    radius = max(radius_cells, 1.0)
    half = int(np.floor(radius + 1e-9))
    nearest = np.maximum(np.abs(np.arange(-half, half + 1)) - half_cell, 0.0)
    return (nearest[:, None] ** 2 + nearest**2 <= radius**2 + 1e-9).astype(np.uint8)


def beyond_border(kernel: Kernel) -> int:
    """Number of rows and columns beyond the border of the fused map that influence the safety of a sole on it."""
    return kernel.shape[0] // 2 + _most_beside(kernel)


def _most_beside(kernel: Kernel) -> int:
    """Largest widening of a sole in the map on each side [cells]."""
    return max(LARGEST_DRIFT_CELLS - kernel.shape[0] // 2, LEAST_MARGIN_CELLS)


def widest_window(kernel: Kernel, resolution: float, limits: TraversabilityLimits, *, is_map: bool) -> float:
    """Distance from the centre of a cell to the farthest corner of the window of `edge_cells` [m]."""
    half_y, half_x = (half_cells(length, resolution) for length in (limits.sole_width, limits.sole_length))
    iy, ix = np.nonzero(kernel if is_map else disc_kernel(limits.disc_radius / resolution, TOUCHED))
    radius = kernel.shape[0] // 2
    more = _most_beside(kernel) if is_map else EXTRA_RING_CELLS
    reach_y, reach_x = np.abs(iy - radius) + more, np.abs(ix - radius) + more
    return float(np.hypot(half_y + reach_y + 0.5, half_x + reach_x + 0.5).max()) * resolution


def half_cells(length: float, resolution: float) -> int:
    """Cells to each side of the centre cell that a sole of this length touches."""
    return int(np.ceil((length / 2 - resolution / 2) / resolution - 1e-9)) if length > resolution else 0
