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

from guara_perception.arrays import Array, Float, Float32, Index, Mask
from guara_perception.ranging.stripe_points import StripePoints
from guara_perception.stripes.kernel.library import address, addresses, kernel
from guara_perception.terrain.assessment.raster import SurfaceSamples

# Key of a swath: (index, index) for one stripe, (index, next index) for the surface between two neighbours.
Key = tuple[int, int]
# How a stripe is linked to a neighbour, as in links.c: in no column, in all, or where their returns agree.
NOWHERE, IN_ALL, WHERE_THEY_AGREE = range(3)
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
    return samples_of(seen, np.array([stripes[index].variance for index in seen.indices]), resolution)


def surface_lines(
    stripes: Mapping[int, StripePoints],
    keys: Sequence[Key],
    pattern: range,
    join_height: float,
    resolution: float,
    y_range: tuple[float, float] = EVERYWHERE,
) -> Iterator[tuple[Lines, Index]]:
    """Yield the surface of `surface_of` as lines on which its samples lie; a point is a line of one sample.

    Each item also holds the indices of the lines whose successor belongs to the next image column of the same stripe
    or pair.
    """
    seen = links_of(stripes, keys, pattern, join_height, y_range)
    indices = np.flatnonzero(seen.confirmed)
    points = seen.points.reshape(3, -1).take(indices, axis=1)
    is_open = np.zeros(indices.size, dtype=bool)
    width = seen.points.shape[2]
    yield Lines(points.astype(np.float64), np.zeros(points.shape), is_open, is_open, 1), _neighbours(indices, width)
    difference, (before, between, after) = seen.points[:, 1:] - seen.points[:, :-1], seen.links
    numbers = np.array(sample_count(seen.longest, resolution), np.int64)
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
        counts: numbers of confirmed points of each of the s stripes, and of wanted lines of each of the s - 1 pairs.
        longest: (s - 1,) float32, length of the longest of all lines of each pair along the ground [m].
    """

    indices: list[int]
    points: Array
    confirmed: Mask
    own: list[int]
    links: tuple[Mask, Mask, Mask]
    wanted: Mask
    pairs: list[int]
    counts: tuple[list[int], list[int]]
    longest: Float32


def links_of(
    stripes: Mapping[int, StripePoints],
    keys: Sequence[Key],
    pattern: range,
    join_height: float,
    y_range: tuple[float, float],
    parted: Collection[Key] = (),
) -> Links:
    """Points and links of the stripes in `keys`; arguments as in `surface_of`."""
    numbers, stride = {key: number for number, key in enumerate(keys)}, pattern.step
    indices = sorted({index for key in keys for index in key})
    around = sorted({near for index in indices for near in (index - stride, index, index + stride) if near in stripes})
    rows = [around.index(index) for index in indices]
    own = [numbers.get((index, index), -1) for index in indices]
    pairs = [numbers.get(key, -1) for key in itertools.pairwise(indices)]

    def link(index: int, other: int) -> int:
        if other not in stripes:
            # Beyond an end of the pattern, no stripe could contradict the surface.
            return IN_ALL if index not in pattern or other not in pattern else NOWHERE
        return NOWHERE if (min(index, other), max(index, other)) in parted else WHERE_THEY_AGREE

    asked = [
        (row, link(index, index - stride), link(index, index + stride), swath >= 0, pair >= 0)
        for row, index, swath, pair in zip(rows, indices, own, [*pairs, -1], strict=True)
    ]
    how = np.array(asked, np.int64)
    # Each coordinate is contiguous in memory, which is several times faster than points one after the other.
    points = np.empty((3, len(around), len(stripes[indices[0]].variance)), dtype=np.float32)
    for row, index in enumerate(around):
        points[:, row] = stripes[index].points.T
    strength, (_, _, width) = np.array([stripes[index].strength for index in around]), points.shape
    masks, counts = np.empty((5, len(indices), width), np.bool_), np.empty((2, len(indices)), np.int64)
    longest = np.empty(len(indices), np.float32)
    given = *addresses(points, strength), len(around), width, address(how), len(indices), join_height, *y_range
    kernel().link_stripes(*given, *addresses(masks, counts, longest))
    before, after, confirmed, between, wanted = masks
    links, (of_stripes, of_pairs) = (before[:-1], between[:-1], after[1:]), counts.tolist()
    points = points.take(rows, axis=1)
    return Links(indices, points, confirmed, own, links, wanted[:-1], pairs, (of_stripes, of_pairs[:-1]), longest[:-1])


def samples_of(seen: Links, variance: Array, resolution: float) -> SurfaceSamples:
    """Samples at the confirmed points, then on the lines between each stripe and the next where they are linked.

    A line is shortened by OPEN_END_M at an end at which the surface ends; the heights of the samples cut off are NaN.
    Variances are interpolated linearly, not by squared weights, because a line is no more certain than the points at
    its ends; a variance for the relief of the ground between the stripes is added.

    Args:
        seen: points and links of s stripes.
        variance: (s, w) float32 variance of the heights [m^2].
        resolution: edge of the cells to be filled [m].
    """
    (of_stripes, of_pairs), (_, count, width) = seen.counts, seen.points.shape
    numbers = [n if m else 0 for n, m in zip(sample_count(seen.longest, resolution), of_pairs, strict=True)]
    lengths = [*of_stripes, *(n * m for n, m in zip(numbers, of_pairs, strict=True))]
    number, size = np.array(numbers, np.int64), sum(lengths)
    samples, along, work = np.empty((3, size)), np.empty(size), np.empty(15 * (width + 1))
    given = *addresses(seen.points, variance), count, width
    links = addresses(seen.confirmed, *seen.links, seen.wanted, number)
    kernel().sample_surface(*given, *links, OPEN_END_M, size, *addresses(work, samples, along))
    swaths = zip((*seen.own, *seen.pairs), lengths, strict=True)
    return SurfaceSamples(samples, along, [(swath, length) for swath, length in swaths if length])


def _neighbours(indices: Index, width: int) -> Index:
    """Positions in flat indices of (stripe, column) at which the next entry is the next column of the stripe."""
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

    The positions are the same whether or not samples are cut off at an end: a further stripe may bring samples
    back, but moves none.
    """
    return ((np.arange(n) + 0.5) / n)[:, None]


def sample_count(longest: Float32, resolution: float) -> list[int]:
    """Number of samples per line in each of s sets of lines, from 2 to 64.

    Within these bounds, the longest line of a set has at least SAMPLES_PER_CELL samples per cell length.

    Args:
        longest: (s,) lengths of the longest lines along the ground [m].
        resolution: edge of the cells to be filled [m].
    """
    return [min(max(math.ceil(SAMPLES_PER_CELL * length / resolution), 2), 64) for length in longest.tolist()]
