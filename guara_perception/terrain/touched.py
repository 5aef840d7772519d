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
    lowest, middle, highest = touched_rows_and_columns(grid, x, y, half)
    for iy in (lowest[0], middle[0], highest[0]):
        for ix in (lowest[1], middle[1], highest[1]):
            yield iy, ix


def touched_rows_and_columns(
    grid: HasIndices, x: Float, y: Float, half: float
) -> tuple[tuple[Index, Index], tuple[Index, Index], tuple[Index, Index]]:
    """Cells (iy, ix) of the lowest corner, the centre and the highest corner of the same squares.

    A square touches all rows and columns from the one corner's to the other's, which are at most two apart.
    """
    reach = half - SHRUNK_M
    return grid.indices(x - reach, y - reach), grid.indices(x, y), grid.indices(x + reach, y + reach)
