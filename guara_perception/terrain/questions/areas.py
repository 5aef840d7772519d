"""Connected component of a cell, and distance transform of a shrinking area, without OpenCV (guara-client lacks it)."""

from __future__ import annotations

import math

import numpy as np

from guara_perception.arrays import Index32, Mask


def connected_to(cells: Mask, iy: int, ix: int) -> Mask:
    """4-connected component of the cell (iy, ix) in a mask.

    The search works on runs of cells along x, of which there are few. Runs that overlap in neighbouring rows are
    connected.

    Args:
        cells: (ny, nx) mask that contains cell (iy, ix).
        iy, ix: indices of the cell.
    """
    ny, nx = cells.shape
    # An empty column at the end keeps runs from continuing in the next row.
    width = nx + 1
    flat = np.zeros(ny * width + 1, np.int8)
    flat[:-1].reshape(ny, width)[:, :nx] = cells
    change = np.flatnonzero(flat[1:] != flat[:-1]) + 1
    if flat[0]:
        change = np.concatenate(([0], change))
    starts, ends = change[::2], change[1::2]
    # For each run, the range [first, after) of the runs that overlap it in the previous row, and in the next row.
    neighbours = [
        (np.searchsorted(ends, starts + step, "right").tolist(), np.searchsorted(starts, ends + step, "left").tolist())
        for step in (-width, width)
    ]
    seed = int(np.searchsorted(starts, iy * width + ix, "right")) - 1
    found, left = {seed}, [seed]
    while left:
        run = left.pop()
        for first, after in neighbours:
            for other in range(first[run], after[run]):
                if other not in found:
                    found.add(other)
                    left.append(other)
    runs = np.fromiter(found, np.intp, len(found))
    result = np.zeros(flat.size, np.int8)
    result[starts[runs]] = 1
    result[ends[runs]] = -1
    return np.cumsum(result, dtype=np.int8)[:-1].reshape(ny, width)[:, :nx] > 0


class Depth:
    """Squared distance of each cell of an area from the nearest cell outside; cells can be removed from the area.

    Attributes:
        squares: (ny, nx) squared distances between cell centres [cells^2], integers; 0 outside the area. Cells beyond
            the border of the grid are outside.
    """

    squares: Index32

    def __init__(self, area: Mask) -> None:
        padded = np.pad(area, 1)
        self.squares = _squares(~padded, math.isqrt(padded.size))[1:-1, 1:-1]

    def deepest(self) -> tuple[int, int, float]:
        """Cell (iy, ix) that is deepest in the area, and its depth [cells]."""
        iy, ix = divmod(int(self.squares.argmax()), self.squares.shape[1])
        return iy, ix, math.sqrt(self.squares[iy, ix])

    def remove(self, rows: slice, columns: slice, cells: Mask) -> None:
        """Remove cells from the area; `cells` is their mask over these rows and columns."""
        # The largest depth, rounded down: cells more than this many rows or columns away are not affected.
        reach = math.isqrt(int(self.squares.max()))
        top, left = max(rows.start - reach, 0), max(columns.start - reach, 0)
        part = self.squares[top : rows.start + cells.shape[0] + reach, left : columns.start + cells.shape[1] + reach]
        taken = np.zeros(part.shape, dtype=bool)
        taken[rows.start - top :, columns.start - left :][: cells.shape[0], : cells.shape[1]] = cells
        np.minimum(part, _squares(taken, reach), out=part)


def _squares(cells: Mask, reach: int) -> Index32:
    """Squared distances (ny, nx) int32 from the nearest cell of a mask.

    Beyond `reach`, the value is at least the smaller of the true square and (reach + 1)^2.
    """
    ny, nx = cells.shape
    row = np.arange(ny, dtype=np.int32)[:, None]
    # Distances along y to the nearest cell of the mask at or before this row, and at or after it.
    before = row - np.maximum.accumulate(np.where(cells, row, -reach - ny), axis=0)
    after = np.minimum.accumulate(np.where(cells, row, reach + 2 * ny)[::-1], axis=0)[::-1] - row
    along = np.minimum(np.minimum(before, after), reach + 1).astype(np.int32) ** 2
    result = along.copy()
    # A cell is never farther from the mask than along y, so larger offsets along x cannot reduce its distance.
    for offset in range(1, min(math.isqrt(int(along.max())), reach, nx - 1) + 1):
        square = np.int32(offset * offset)
        np.minimum(result[:, offset:], along[:, :-offset] + square, out=result[:, offset:])
        np.minimum(result[:, :-offset], along[:, offset:] + square, out=result[:, :-offset])
    return result
