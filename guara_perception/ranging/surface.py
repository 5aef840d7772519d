"""Surface of a scan: points of stripes that both neighbours confirm, and lines between neighbours that agree.

Two neighbouring stripes of the pattern are linked in an image column only if their heights differ by less than
`join_height`. A stripe can confirm returns of another stripe but never create them, so fewer stripes give less surface.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from guara_perception.arrays import Array, Float, Index, Mask
from guara_perception.ranging.stripe_points import StripePoints
from guara_perception.stripes.kernel.library import addresses, kernel
from guara_perception.terrain.assessment.raster import SurfaceSamples

# Key of a swath: (index, index) for one stripe, (index, next index) for the surface between two neighbours.
Key = tuple[int, int]
# Ratio of two strengths below which the weaker return may be cut by an edge or a shadow.
WEAK_RATIO = 0.4
# Largest height difference at which two returns of such different strength are joined.
WEAK_JOIN_HEIGHT_M = 0.0015
EVERYWHERE = (-math.inf, math.inf)
# Samples per cell length along a joining line: every cell that the line crosses for more than a third of a cell length
# gets a sample.
SAMPLES_PER_CELL = 3
# Length by which a joining line is shortened at the end of a surface, where part of the stripe's width may lie beyond
# the edge.
OPEN_END_M = 0.0005


def surface_of(
    stripes: Mapping[int, StripePoints],
    keys: Sequence[Key],
    pattern: range,
    join_height: float,
    resolution: float,
    y_range: tuple[float, float] = EVERYWHERE,
    parted: Collection[Key] = (),
) -> SurfaceSamples:
    """Samples of the surface: points of stripes that both neighbours confirm, and lines between pairs of stripes.

    Args:
        stripes: points by index.
        keys: (index, index) of stripes and (index, next index) of pairs; each is a swath, numbered in this order.
        pattern: indices of the stripes of the scan's mode.
        join_height: limit of the height difference between neighbouring points of one surface [m].
        resolution: edge of the cells to be filled [m].
        y_range: range of y [m]; points outside it, and lines wholly outside it, are omitted.
        parted: (index, next index) of neighbours that do not confirm each other, whatever their heights.
    """
    seen = links_of(stripes, keys, pattern, join_height, y_range, parted)
    variance = np.array([stripes[index].variance for index in seen.indices])
    return joined_surface(confirmed_points(seen, variance), seen, variance, resolution)


def surface_lines(
    stripes: Mapping[int, StripePoints],
    keys: Sequence[Key],
    pattern: range,
    join_height: float,
    resolution: float,
    y_range: tuple[float, float] = EVERYWHERE,
) -> Iterator[tuple[Lines, Index]]:
    """Yield the surface of `surface_of` as lines on which its samples lie; a point is a line of one sample.

    Each item also holds the positions of the lines whose successor belongs to the next image column of the same stripe
    or pair.
    """
    seen = links_of(stripes, keys, pattern, join_height, y_range)
    indices = np.flatnonzero(seen.confirmed)
    points = seen.points.reshape(3, -1).take(indices, axis=1)
    is_open = np.zeros(indices.size, dtype=bool)
    width = seen.points.shape[2]
    yield Lines(points.astype(np.float64), np.zeros(points.shape), is_open, is_open, 1), _neighbours(indices, width)
    difference, (before, between, after) = seen.points[:, 1:] - seen.points[:, :-1], seen.links
    # Counted over all linked columns, so that sample counts do not depend on the requested ones.
    numbers = np.array(sample_count(difference, between, resolution), np.int64)
    lines = between & seen.wanted
    for number in np.unique(numbers[lines.any(axis=1)]).tolist():
        indices = np.flatnonzero(lines & (numbers == number)[:, None])
        first, vectors = (
            each.reshape(3, -1).take(indices, axis=1).astype(np.float64) for each in (seen.points, difference)
        )
        found = Lines(first, vectors, ~before.take(indices), ~after.take(indices), number)
        yield found, _neighbours(indices, width)


def surface_keys(stripes: Collection[int], pattern: range) -> list[Key]:
    """Keys of all stripes (index, index) and pairs of neighbours of the pattern (index, next index), in order."""
    return [key for k in sorted(stripes) for key in ((k, k), (k, k + pattern.step)) if key[1] in stripes]


@dataclass(frozen=True, slots=True)
class Links:
    """Points of some stripes, and their links to the neighbouring stripes.

    Attributes:
        indices: indices of s stripes.
        points: (3, s, w) float32 points of these stripes.
        confirmed: (s, w) mask of the requested points inside `y_range` that the stripes on both sides confirm.
        own: number of the swath of each of the s stripes, -1 if not requested.
        links: three masks (s - 1, w) with one row for each pair of successive stripes: the first stripe is linked to
            the one before it; the two are linked to each other, and the pair is requested; the second is linked to the
            one after it.
        wanted: (s - 1, w) mask of the columns whose lines are not wholly outside `y_range`.
        pairs: number of the swath of each of the s - 1 pairs, -1 if not requested.
    """

    indices: list[int]
    points: Array
    confirmed: Mask
    own: list[int]
    links: tuple[Mask, Mask, Mask]
    wanted: Mask
    pairs: list[int]


def links_of(
    stripes: Mapping[int, StripePoints],
    keys: Sequence[Key],
    pattern: range,
    join_height: float,
    y_range: tuple[float, float],
    parted: Collection[Key] = (),
) -> Links:
    """Points and links of the stripes in `keys`; arguments as in `surface_of`."""
    numbers = {key: number for number, key in enumerate(keys)}
    indices = sorted({index for key in keys for index in key})
    # Each coordinate is contiguous in memory, which is several times faster than points one after the other.
    points = np.empty((3, len(indices), len(stripes[indices[0]].variance)), dtype=np.float32)
    for row, index in enumerate(indices):
        points[:, row] = stripes[index].points.T
    before, after = _links(stripes, indices, pattern, join_height, parted)
    low, high = points[1] < y_range[0], points[1] > y_range[1]
    own = [numbers.get((index, index), -1) for index in indices]
    pairs = [numbers.get(key, -1) for key in itertools.pairwise(indices)]
    return Links(
        indices,
        points,
        before & after & ~(low | high) & _is_requested(own) & np.isfinite(points[2]),
        own,
        (before[:-1], after[:-1] & _is_requested(pairs), after[1:]),
        ~((low[:-1] & low[1:]) | (high[:-1] & high[1:])),
        pairs,
    )


def linked_columns(heights: tuple[Array, Array], strengths: tuple[Array, Array], join_height: float) -> Mask:
    """Mask of the columns in which two neighbouring stripes lie on one surface.

    A stripe that is cut by an edge or a shadow is weak and displaced. Where one of the two returns is much weaker than
    the other, their heights must therefore agree more closely.

    Args:
        heights: two (..., w) heights of neighbouring stripes [m].
        strengths: two (..., w) strengths of their returns [grey levels].
        join_height: limit of the height difference between neighbouring points of one surface [m].

    Returns:
        (..., w) bool, True where both have a point and the height difference is below the limit.
    """
    with np.errstate(invalid="ignore"):
        weaker, stronger = np.minimum(*strengths), np.maximum(*strengths)
        allowed = np.where(weaker < WEAK_RATIO * stronger, min(WEAK_JOIN_HEIGHT_M, join_height), join_height)
        return np.asarray(np.abs(heights[1] - heights[0]) < allowed)


def _links(
    stripes: Mapping[int, StripePoints], indices: list[int], pattern: range, join_height: float, parted: Collection[Key]
) -> tuple[Mask, Mask]:
    """Masks (s, w) of the columns in which each stripe is linked to the previous one and to the next one.

    No column is linked if the neighbour is missing or the two are parted. All columns are linked to a neighbour beyond
    an end of the pattern, because no stripe there could contradict the surface.
    """
    stride = pattern.step
    around = sorted({near for index in indices for near in (index - stride, index, index + stride) if near in stripes})
    heights = np.array([stripes[index].points[:, 2] for index in around])
    strengths = np.array([stripes[index].strength for index in around])
    linked = np.empty((len(around) + 1, heights.shape[1]), dtype=bool)
    linked[1:-1] = linked_columns((heights[:-1], heights[1:]), (strengths[:-1], strengths[1:]), join_height)
    rows = [around.index(index) for index in indices]
    before, after = linked[rows], linked[[row + 1 for row in rows]]
    for row, index in enumerate(indices):
        for link, other in ((before, index - stride), (after, index + stride)):
            if other not in stripes:
                link[row] = index not in pattern or other not in pattern
            elif (min(index, other), max(index, other)) in parted:
                link[row] = False
    return before, after


def _is_requested(numbers: list[int]) -> Mask:
    """Mask (n, 1) of the requested swaths: those whose number is not -1."""
    return np.array([number >= 0 for number in numbers], dtype=bool)[:, None]


def confirmed_points(seen: Links, variance: Array) -> SurfaceSamples:
    """Samples at the confirmed points of stripes.

    Args:
        seen: points and links of s stripes.
        variance: (s, w) variance of the heights [m^2].
    """
    indices = np.flatnonzero(seen.confirmed)
    lengths = seen.confirmed.sum(axis=1).tolist()
    runs = [(swath, length) for swath, length in zip(seen.own, lengths, strict=True) if length]
    return SurfaceSamples(seen.points.reshape(3, -1).take(indices, axis=1), variance.take(indices), runs)


def joined_surface(given: SurfaceSamples, seen: Links, variance: Array, resolution: float) -> SurfaceSamples:
    """Given samples, then those of the lines between each stripe and the next in the columns in which they are linked.

    A line is shortened by OPEN_END_M at an end at which the surface ends; the heights of the samples cut off are NaN.
    Variances are interpolated linearly, not by squared weights, because a line is no more certain than the points at
    its ends; the relief of the ground between the stripes is added.

    Args:
        given: samples before those of the lines.
        seen: points and links of s stripes.
        variance: (s, w) variance of the heights [m^2].
        resolution: edge of the cells to be filled [m].
    """
    before, between, after = seen.links
    lines, points = between & seen.wanted, np.ascontiguousarray(seen.points, np.float32)
    variance = np.ascontiguousarray(variance, np.float32)
    # Counted over all linked columns, so that sample counts do not depend on the requested ones.
    numbers = sample_count(points[:, 1:] - points[:, :-1], between, resolution)
    runs = [(swath, n * int(m)) for swath, n, m in zip(seen.pairs, numbers, lines.sum(axis=1), strict=True) if m]
    wanted = np.where(lines.any(axis=1), numbers, 0).astype(np.int64)
    begin, (_, count, width) = given.variance.size, points.shape
    size = begin + sum(length for _, length in runs)
    samples, along, work = np.empty((3, size)), np.empty(size), np.empty(15 * (width + 1))
    samples[:, :begin], along[:begin] = given.points, given.variance
    opens, closes = ~before, ~after
    of_stripes = *addresses(points, variance), count, width, *addresses(lines, opens, closes, wanted), OPEN_END_M
    kernel().sample_lines(*of_stripes, size, begin, *addresses(work, samples, along))
    return SurfaceSamples(samples, along, [*given.runs, *runs])


def _neighbours(indices: Index, width: int) -> Index:
    """Positions of the flat indices of (stripe, column) whose successor is the next column of the same stripe."""
    return np.flatnonzero((np.diff(indices) == 1) & ((indices[:-1] + 1) % width > 0))


@dataclass(frozen=True, slots=True)
class Lines:
    """Straight lines of the surface between two stripes, or single points; all have the same number of samples.

    Attributes:
        first: (3, c) first point of each line, in base_footprint [m].
        difference: (3, c) vector from the first to the last point [m].
        opens, closes: (c,) masks of the lines at whose first or last point, respectively, the surface ends.
        number: number of samples on each line.
    """

    first: Float
    difference: Float
    opens: Mask
    closes: Mask
    number: int

    def cut(self) -> Index:
        """Flat indices into the samples (number, c) of those that are cut off at open ends."""
        share = shares(self.number)
        at_ends = np.flatnonzero(self.opens | self.closes)
        run = np.maximum(np.hypot(*self.difference[:2].take(at_ends, axis=1)), 1e-9)
        length = np.minimum(OPEN_END_M / run, 0.5)
        # Usually no sample lies in the part that is cut off.
        if length.max(initial=0.0) <= min(share[0], 1 - share[-1]):
            return np.empty(0, np.intp)
        start, end = np.where(self.opens[at_ends], length, 0.0), 1 - np.where(self.closes[at_ends], length, 0.0)
        row, line = np.nonzero((share < start) | (share > end))
        return np.asarray(row * self.opens.size + at_ends[line])


@functools.cache
def shares(n: int) -> Float:
    """Positions (n, 1) of n samples along a line, as fractions of its length.

    The positions are the same whether or not samples are cut off at an end, so that another stripe cannot move samples.
    """
    return ((np.arange(n) + 0.5) / n)[:, None]


def sample_count(difference: Array, is_line: Mask, resolution: float) -> list[int]:
    """Number of samples per line in each of s sets of lines (3, s, w), from 2 to 64.

    Within these bounds, the longest line of a set has at least SAMPLES_PER_CELL samples per cell length.
    """
    squares = np.where(is_line, difference[0] ** 2 + difference[1] ** 2, 0)
    longest = np.sqrt(squares.max(axis=1)).tolist()
    return [min(max(math.ceil(SAMPLES_PER_CELL * length / resolution), 2), 64) for length in longest]
