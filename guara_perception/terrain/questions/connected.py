"""Connected component of a cell, without OpenCV, which guara-client lacks."""

from __future__ import annotations

import numpy as np

from guara_perception.arrays import Mask


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
