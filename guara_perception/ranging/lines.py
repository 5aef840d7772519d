"""Straight lines between neighbouring stripes, and the samples on them."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np

from guara_perception.arrays import Array, Float, Index, Mask
from guara_perception.ranging.stripe_points import ColumnPoints

# Samples along a joining line are at most a third of a cell apart, so that no crossed cell is missed.
SAMPLES_PER_CELL = 3
# At the end of a surface its last stripe may extend beyond the edge by part of the stripe's width on the ground.
OPEN_END_M = 0.0005


@dataclass(frozen=True, slots=True)
class Lines:
    """Straight lines of the surface, from a stripe to the next, all with the same number of samples.

    Attributes:
        first: (3, c) first point of each line, in base_footprint [m].
        difference: (3, c) vector from the first to the last point [m].
        opens, closes: (c,) masks of the lines at whose first, or last, point the surface ends.
        number: number of samples on each line.
    """

    first: Float
    difference: Float
    opens: Mask
    closes: Mask
    number: int

    def filled(self, followed: Index, between: int) -> Lines:
        """Lines with interpolated ones added between those of neighbouring image columns.

        Args:
            followed: positions of the lines that are followed by that of the next image column.
            between: number of lines between two neighbours.
        """
        ways = np.arange(1, between + 1) / (between + 1)

        def vectors(own: Float) -> Float:
            first, second = own[:, followed], own[:, followed + 1]
            return np.concatenate([own, *(first * (1 - way) + second * way for way in ways)], axis=1)

        def masks(own: Mask) -> Mask:
            return np.concatenate([own, np.tile(own[followed] | own[followed + 1], between)])

        return Lines(vectors(self.first), vectors(self.difference), masks(self.opens), masks(self.closes), self.number)

    def cut(self) -> Index:
        """Flat indices of the samples, (number, c), that are cut off at open ends."""
        share, _, _ = shares(self.number)
        at_ends = np.flatnonzero(self.opens | self.closes)
        run = np.maximum(np.hypot(*self.difference[:2].take(at_ends, axis=1)), 1e-9)
        length = np.minimum(OPEN_END_M / run, 0.5)
        # Usually the cut ends before the nearest sample.
        if length.max(initial=0.0) <= min(share[0], 1 - share[-1]):
            return np.empty(0, np.intp)
        start, end = np.where(self.opens[at_ends], length, 0.0), 1 - np.where(self.closes[at_ends], length, 0.0)
        row, line = np.nonzero((share < start) | (share > end))
        return np.asarray(row * self.opens.size + at_ends[line])


@functools.cache
def shares(n: int) -> tuple[Float, Float, Float]:
    """Fraction of a line before each of n samples (n, 1), and the weights there of the variances of its two ends.

    The positions do not depend on other stripes: samples that are cut off do not move the rest.
    """
    share = ((np.arange(n) + 0.5) / n)[:, None]
    return share, (1 - share) ** 2, share**2


def line_samples(ends: tuple[ColumnPoints, ColumnPoints], resolution: float) -> Float:
    """Points (n, 3) along the lines between two stripes, in all columns in which both have a point."""
    _, in_first, in_second = np.intersect1d(ends[0].columns, ends[1].columns, assume_unique=True, return_indices=True)
    if not in_first.size:
        return np.empty((0, 3))
    first = ends[0].points[in_first]
    difference = ends[1].points[in_second] - first
    (n,) = sample_count(difference.T[:, None], np.ones((1, len(difference)), dtype=bool), resolution)
    share, _, _ = shares(n)
    return np.asarray((first + share[..., None] * difference).reshape(-1, 3))


def sample_count(difference: Array, is_line: Mask, resolution: float) -> list[int]:
    """Samples per line so that no crossed cell is missed, at most 64, for each of s sets of lines (3, s, w)."""
    squares = np.where(is_line, difference[0] ** 2 + difference[1] ** 2, 0)
    longest = np.sqrt(squares.max(axis=1)).tolist()
    return [min(max(math.ceil(SAMPLES_PER_CELL * length / resolution), 2), 64) for length in longest]
