"""Memory of the rolling map: cells fixed in `odom`, in a window that follows the robot."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from guara_perception.arrays import Array, Float, Index
from guara_perception.terrain.layers.geometry import GridGeometry
from guara_perception.terrain.layers.hazard import Hazard

NEVER = -1
# Layers of the memory: type, and the value of a cell that was never seen.
MEMORY: dict[str, tuple[Any, Any]] = {
    "height": (np.float64, np.nan),  # [m] in odom
    "variance": (np.float64, 0.0),  # variance of the height when last seen [m^2]
    "local": (np.float64, 0.0),  # part of the variance that is not shared by neighbours [m^2]
    "apart": (np.float64, 0.0),  # variance of one look, from the differences between looks, without noise [m^2]
    "below": (np.float64, 0.0),  # distance of the lowest sample below the height [m]
    "above": (np.float64, 0.0),  # distance of the highest sample above the height [m]
    "steepness": (np.float64, 0.0),  # tan^2 of the slope when last seen
    "cause": (np.uint16, np.uint16(Hazard.UNSCANNED)),  # causes of an unknown cell, 0 if known
    "conflict": (np.bool_, False),  # True if the last observations disagree
    "other": (np.float64, np.nan),  # last observed height in a conflict [m]
    "other_variance": (np.float64, 0.0),  # variance of that height [m^2]
    "pause": (np.int64, NEVER),  # number of the pause when last seen
    "stamp": (np.int64, 0),  # time when last seen [ns]
    "looks": (np.uint8, 0),  # number of scans with a height here since the cell became known, 255 at most
    "rise": (np.float64, 0.0),  # variance of the drift of odometry in z when last seen [m^2]
    "shift": (np.float64, 0.0),  # upper bound of the variance of horizontal drift when last seen [m^2]
    "turn": (np.float64, 0.0),  # variance of heading drift when last seen [rad^2]
}
# Each side of a square is moved inward by this length, so that a square that only shares an edge with a cell does not
# touch the cell.
SHRUNK_M = 1e-7


class OdomCells:
    """Cells aligned with the axes of `odom`, never moved or resampled.

    Cell (cy, cx) covers cx * resolution <= x < (cx + 1) * resolution, and likewise along y. It is stored in row cy mod
    n and column cx mod n, so that a move of the window only clears the rows and columns that enter.

    Attributes:
        resolution: cell edge [m].
        side: number n of rows and columns of the window.
        memory: arrays (n * n,) by the names in MEMORY.
        first: cell (cy, cx) of the window with the smallest indices, None before the window is placed.
    """

    def __init__(self, resolution: float, side: int) -> None:
        """Create an empty window.

        Args:
            resolution: cell edge [m].
            side: number of rows and columns of the window.
        """
        self.resolution, self.side = resolution, side
        self.memory = {name: np.full(side**2, empty, dtype) for name, (dtype, empty) in MEMORY.items()}
        self.first: tuple[int, int] | None = None

    def indices(self, x: Float, y: Float) -> tuple[Index, Index]:
        """Cells (cy, cx) that contain points in `odom` [m]."""
        cx = np.floor(x / self.resolution + 1e-6).astype(np.int64)
        cy = np.floor(y / self.resolution + 1e-6).astype(np.int64)
        return cy, cx

    def cells_between(self, low: tuple[float, float], high: tuple[float, float]) -> tuple[Index, Index]:
        """Cells (cy, cx), (n,) each, of the axis-aligned rectangle between corners `low` and `high`, both (x, y) [m].

        Once the window is placed, only cells in it are returned.
        """
        (x0, y0), (x1, y1) = ((int(np.floor(v / self.resolution)) for v in corner) for corner in (low, high))
        if self.first is not None:
            first_y, first_x = self.first
            x0, y0 = max(x0, first_x), max(y0, first_y)
            x1, y1 = min(x1, first_x + self.side - 1), min(y1, first_y + self.side - 1)
        cx, cy = np.meshgrid(np.arange(x0, x1 + 1), np.arange(y0, y1 + 1))
        return cy.ravel(), cx.ravel()

    def slots(self, cy: Index, cx: Index) -> Index:
        """Slots of cells in the arrays of memory, -1 for cells outside the window."""
        if self.first is None:
            return np.full(np.broadcast_shapes(np.shape(cy), np.shape(cx)), -1, dtype=np.int64)
        first_y, first_x = self.first
        inside = (cy >= first_y) & (cy < first_y + self.side) & (cx >= first_x) & (cx < first_x + self.side)
        return np.where(inside, (cy % self.side) * self.side + cx % self.side, -1)

    def patch(self, name: str, first: tuple[int, int], shape: tuple[int, int], outside: Any) -> Array:
        """Copy of a layer of the memory over a rectangle of cells.

        Args:
            name: name of the layer in MEMORY.
            first: (cy, cx) of the first cell of the rectangle, which has the smallest indices.
            shape: (rows, columns) of the rectangle.
            outside: value of cells outside the window.
        """
        square = self.memory[name].reshape(self.side, self.side)
        values = np.full(shape, outside, square.dtype)
        if self.first is None:
            return values
        rows, columns = (self._pieces(first[axis], shape[axis], self.first[axis]) for axis in (0, 1))
        for to_rows, from_rows in rows:
            for to_columns, from_columns in columns:
                values[to_rows, to_columns] = square[from_rows, from_columns]
        return values

    def _pieces(self, first: int, count: int, window: int) -> list[tuple[slice, slice]]:
        """Slices of rows (or columns) of a rectangle, each paired with the corresponding slice of memory.

        They cover the part of the rectangle in the window: two pairs if this part wraps around in memory, none if it is
        empty.
        """
        low, high = max(first, window), min(first + count, window + self.side)
        turn = low + -low % self.side
        runs = ((low, min(turn, high)), (max(low, turn), high))
        return [
            (slice(start - first, end - first), slice(start % self.side, (end - 1) % self.side + 1))
            for start, end in runs
            if end > start
        ]

    def restore(self, memory: Mapping[str, Array], first: tuple[int, int] | None) -> None:
        """Copy memory and `first` from another window of the same size."""
        for name, values in self.memory.items():
            np.copyto(values, memory[name])
        self.first = first

    def centre_on(self, x: float, y: float) -> None:
        """Centre the window on a point in `odom`, and forget the cells that leave it."""
        cy, cx = (int(np.floor(value / self.resolution)) - self.side // 2 for value in (y, x))
        old, self.first = self.first, (cy, cx)
        if old is None:
            return
        window = np.arange(self.side)
        rows, columns = (
            np.setdiff1d(new + window, before + window) for new, before in zip(self.first, old, strict=True)
        )
        for name, (_, empty) in MEMORY.items():
            square = self.memory[name].reshape(self.side, self.side)
            square[rows % self.side] = empty
            square[:, columns % self.side] = empty


@dataclass(frozen=True, slots=True)
class Squares:
    """Squares over a grid, for reductions over the cells touched by each square.

    Attributes:
        first: (iy, ix) of the first cell of the block that contains all touched cells.
        shape: number of rows and columns of the block.
        most: largest numbers of rows and columns touched by one square.
        entry: (n,) flat index of each square in the table of `joined`.
    """

    first: tuple[int, int]
    shape: tuple[int, int]
    most: tuple[int, int]
    entry: Index

    @classmethod
    def of(cls, grid: OdomCells | GridGeometry, x: Float, y: Float, half: float) -> Squares:
        """Axis-aligned squares of edge 2 * `half` around n >= 1 points, such as bounding squares of rotated cells."""
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
        """Reduce an array over the cells touched by each square.

        Args:
            layer: values of the block, of shape `shape`.
            join: commutative and associative ufunc of two arguments, such as `np.bitwise_or`.
            which: indices of the squares; None = all.
        """
        rows, columns = self.most
        # table[i, j] reduces i + 1 rows and j + 1 columns, starting at each cell. Entries near the end of the block are
        # incomplete, but no square reads them.
        table = np.empty((rows, columns, *self.shape), layer.dtype)
        table[0, 0] = layer
        for down in range(1, rows):
            table[down, 0] = table[down - 1, 0]
            join(table[down, 0, :-down], layer[down:], out=table[down, 0, :-down])
        for right in range(1, columns):
            table[:, right] = table[:, right - 1]
            join(table[:, right, :, :-right], table[:, 0, :, right:], out=table[:, right, :, :-right])
        return table.take(self.entry if which is None else self.entry[which])
