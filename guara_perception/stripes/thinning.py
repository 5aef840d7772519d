"""Skeleton of a binary picture by Zhang and Suen's parallel thinning, on the foreground pixels only."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import numpy.typing as npt

# Thinning takes one layer of pixels per pass off each side; nothing in a band of rows is thicker than this.
MOST_PASSES = 200


def skeleton(mask: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    """Thin a mask (rows, columns) to lines one pixel wide, connections kept.

    Zhang, Suen: A fast parallel algorithm for thinning digital patterns, CACM 27 (1984): in turn the south-east
    and the north-west border pixels are taken off, those that do not end or connect lines.
    """
    rows, columns = mask.shape
    padded = np.zeros((rows + 2, columns + 2), dtype=np.uint8)
    padded[1:-1, 1:-1] = mask
    flat = padded.ravel()
    width = columns + 2
    # Neighbours P2 ... P9: north first, then clockwise.
    around = np.array([-width, -width + 1, 1, width + 1, width, width - 1, -1, -width - 1])
    pixels = np.flatnonzero(flat)
    for _ in range(MOST_PASSES):
        before = pixels.size
        for table in deletable():
            code = np.zeros(pixels.size, dtype=np.uint8)
            for bit, shift in enumerate(around):
                code |= flat[pixels + shift] << np.uint8(bit)
            goes = table[code]
            flat[pixels[goes]] = 0
            pixels = pixels[~goes]
        if pixels.size == before:
            break
    return padded[1:-1, 1:-1].astype(bool)


@lru_cache(maxsize=1)
def deletable() -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
    """For each of the 256 neighbourhoods whether the pixel may go, for both halves of a pass."""
    codes = np.arange(256)
    p = [(codes >> bit) & 1 for bit in range(8)]
    neighbours = sum(p)
    starts = sum((p[i] == 0) & (p[(i + 1) % 8] == 1) for i in range(8))
    north, east, south, west = p[0], p[2], p[4], p[6]
    removable = (neighbours >= 2) & (neighbours <= 6) & (starts == 1)
    first = removable & (north * east * south == 0) & (east * south * west == 0)
    second = removable & (north * east * west == 0) & (north * south * west == 0)
    return first, second
