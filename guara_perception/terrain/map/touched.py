"""The cells of a grid that rotated squares touch, and the joined values of these cells."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from guara_perception.arrays import Array, Float, Index

# A square that only shares an edge with a cell does not touch it.
SHRUNK_M = 1e-7


class HasIndices(Protocol):
    """Anything that gives cell indices of coordinates."""

    def indices(self, x: Float, y: Float) -> tuple[Index, Index]:
        """Cell indices (iy, ix)."""


@dataclass(frozen=True, slots=True)
class Squares:
    """Squares laid over a grid: which of its cells each of them touches, in the block of the grid that any touches.

    Attributes:
        first: (iy, ix) of the lowest cell of that block.
        shape: number of rows and of columns of that block.
        most: rows and columns that one square touches at most.
        entry: (n,) flat index of each square in the table of joined values.
    """

    first: tuple[int, int]
    shape: tuple[int, int]
    most: tuple[int, int]
    entry: Index

    @classmethod
    def of(cls, grid: HasIndices, x: Float, y: Float, half: float) -> Squares:
        """Upright squares of half edge `half` about points (n,), n >= 1; for rotated ones give the upright ones around.

        They touch all rows and columns from the lowest corner's to the highest one's.
        """
        reach = half - SHRUNK_M
        low_y, low_x = grid.indices(x - reach, y - reach)
        high_y, high_x = grid.indices(x + reach, y + reach)
        first = int(low_y.min()), int(low_x.min())
        shape = int(high_y.max()) - first[0] + 1, int(high_x.max()) - first[1] + 1
        rows, columns = high_y - low_y, high_x - low_x
        most = int(rows.max()) + 1, int(columns.max()) + 1
        lowest = (low_y - first[0]) * shape[1] + low_x - first[1]
        return cls(first, shape, most, (rows * most[1] + columns) * (shape[0] * shape[1]) + lowest)

    def joined(self, layer: Array, join: np.ufunc, which: Index | None = None) -> Array:
        """Values of an array of this shape, joined over all cells that each square touches.

        Args:
            layer: (rows, columns) of the block of the grid.
            join: function of two values that takes them in any order.
            which: indices of the squares; None = all.
        """
        rows, columns = self.most
        # table[i, j] joins i + 1 rows and j + 1 columns from each cell on; no square reaches over the array's edge.
        table = np.empty((rows, columns, *self.shape), layer.dtype)
        table[0, 0] = layer
        for down in range(1, rows):
            table[down, 0] = table[down - 1, 0]
            join(table[down, 0, :-down], layer[down:], out=table[down, 0, :-down])
        for right in range(1, columns):
            table[:, right] = table[:, right - 1]
            join(table[:, right, :, :-right], table[:, 0, :, right:], out=table[:, right, :, :-right])
        return table.take(self.entry if which is None else self.entry[which])
