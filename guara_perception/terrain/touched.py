"""The cells of a grid that turned squares touch."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Protocol

import numpy as np
import numpy.typing as npt

Float = npt.NDArray[np.float64]
Index = npt.NDArray[np.int64]

# A square that only shares an edge with a cell does not touch it.
SHRUNK_M = 1e-7


class HasIndices(Protocol):
    """Anything that tells cell indices from coordinates."""

    def indices(self, x: Float, y: Float) -> tuple[Index, Index]:
        """Cell indices (iy, ix)."""


def touched_places(grid: HasIndices, x: Float, y: Float, half: float) -> Iterator[tuple[Index, Index]]:
    """Cells that the upright squares of half edge `half` about points touch: nine (iy, ix), some of them twice.

    For turned squares give half the edge of the upright square around them. `half` must be less than a cell: then the
    nine points, corners, middles of edges and centre, miss no cell.
    """
    reach = half - SHRUNK_M
    for dy in (-reach, 0.0, reach):
        for dx in (-reach, 0.0, reach):
            yield grid.indices(x + dx, y + dy)
