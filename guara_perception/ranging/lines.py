"""Lines from a stripe to the next, and the samples on them that stand for the surface between the two."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np

from guara_perception.arrays import Array, Float, Index, Mask
from guara_perception.ranging.stripe_points import ColumnPoints

# Samples along a joining line are at most a third of a cell apart, so no crossed cell is missed.
SAMPLES_PER_CELL = 3
# Where a surface ends, the last stripe on it may hang over the edge by a share of its own width on the ground.
OPEN_END_M = 0.0005


@dataclass(frozen=True, slots=True)
class Lines:
    """Straight lines of the surface, from a stripe to the next, all with the same number of samples.

    Attributes:
        first: (3, c) point at which each begins, in base_footprint [m].
        difference: (3, c) vector from there to the point at which it ends [m].
        opens, closes: (c,) whether the surface does not go on before its beginning, or beyond its end.
        number: number of samples on each.
    """

    first: Float
    difference: Float
    opens: Mask
    closes: Mask
    number: int

    def cut(self) -> Index:
        """Flat indices of the samples, (number, c), that are cut off at open ends."""
        share, _, _ = shares(self.number)
        at_ends = np.flatnonzero(self.opens | self.closes)
        run = np.maximum(np.hypot(*self.difference[:2].take(at_ends, axis=1)), 1e-9)
        length = np.minimum(OPEN_END_M / run, 0.5)
        # Most often the cut is shorter than the way to the nearest sample.
        if length.max(initial=0.0) <= min(share[0], 1 - share[-1]):
            return np.empty(0, np.intp)
        start, end = np.where(self.opens[at_ends], length, 0.0), 1 - np.where(self.closes[at_ends], length, 0.0)
        row, line = np.nonzero((share < start) | (share > end))
        return np.asarray(row * self.opens.size + at_ends[line])


@functools.cache
def shares(n: int) -> tuple[Float, Float, Float]:
    """Share of the line before each of n samples (n, 1), and the samples' weights for the variances of its two ends.

    These positions never depend on other stripes: samples that are cut off are left out, the others do not move.
    """
    share = ((np.arange(n) + 0.5) / n)[:, None]
    return share, (1 - share) ** 2, share**2


def line_samples(ends: tuple[ColumnPoints, ColumnPoints], resolution: float) -> Float:
    """Points (n, 3) along the lines between two stripes, in all columns in which both have a point."""
    if not (ends[0].columns.size and ends[1].columns.size):
        return np.empty((0, 3))
    _, in_first, in_second = np.intersect1d(ends[0].columns, ends[1].columns, assume_unique=True, return_indices=True)
    if not in_first.size:
        return np.empty((0, 3))
    first = ends[0].points[in_first]
    difference = ends[1].points[in_second] - first
    (n,) = sample_count(difference.T[:, None], np.ones((1, len(difference)), dtype=bool), resolution)
    share, _, _ = shares(n)
    return np.asarray((first + share[..., None] * difference).reshape(-1, 3))


def sample_count(difference: Array, is_line: Mask, resolution: float) -> list[int]:
    """Samples per line that leave no crossed cell out, for each of s sets of lines (3, s, w) that `is_line` names."""
    squares = np.where(is_line, difference[0] ** 2 + difference[1] ** 2, 0)
    longest = np.sqrt(squares.max(axis=1)).tolist()
    return [min(max(math.ceil(SAMPLES_PER_CELL * length / resolution), 2), 64) for length in longest]
