"""The surface of a scan: of each stripe, and between each stripe and the next."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from guara_perception.arrays import Mask
from guara_perception.ranging.stripe_points import StripePoints
from guara_perception.ranging.surface import confirmed_points, joined_surface, linked_columns
from guara_perception.terrain.assessment.raster import SurfaceSamples

Key = tuple[int, int]


def scan_surface(
    stripes: Mapping[int, StripePoints], pattern: range, join_height: float, resolution: float
) -> Iterator[tuple[Key, SurfaceSamples]]:
    """Surface of every stripe and of every pair of neighbouring stripes.

    Args:
        stripes: points by index.
        pattern: indices of the stripes of the scan's mode; neighbours are those next to each other in it.
        join_height: largest height difference of one surface [m].
        resolution: edge of the cells that will be filled [m].

    Yields:
        ((index, index), surface of that stripe's own points) and ((index, next index), surface between the two).
    """
    for index in sorted(stripes):
        for key in ((index, index), (index, index + pattern.step)):
            if key[1] in stripes:
                yield key, surface_of(stripes, [key], pattern, join_height, resolution)


def surface_of(
    stripes: Mapping[int, StripePoints],
    keys: Sequence[Key],
    pattern: range,
    join_height: float,
    resolution: float,
    y_range: tuple[float, float] = (-np.inf, np.inf),
) -> SurfaceSamples:
    """Surface of stripes, their points that the neighbours on both sides confirm, and of pairs, the lines between.

    Args:
        stripes: points by index.
        keys: (index, index) of stripes and (index, next index) of pairs; each is a part, numbered in this order.
        pattern: indices of the stripes of the scan's mode.
        join_height: largest height difference of one surface [m].
        resolution: edge of the cells that will be filled [m].
        y_range: points and lines wholly on one side of it are not asked for [m].
    """
    numbers = {key: number for number, key in enumerate(keys)}
    indices = sorted({index for key in keys for index in key})
    width = len(stripes[indices[0]].variance)
    # Coordinates apart, each in one piece of memory: several times faster than points in rows.
    points = np.empty((3, len(indices), width), dtype=np.float32)
    for row, index in enumerate(indices):
        points[:, row] = stripes[index].points.T
    variance = np.array([stripes[index].variance for index in indices])
    before, after = _links(stripes, indices, pattern, join_height)
    low, high = points[1] < y_range[0], points[1] > y_range[1]
    own = [numbers.get((index, index), -1) for index in indices]
    confirmed = before & after & ~(low | high) & _named(own)
    found = [confirmed_points(points, variance, confirmed, own)]
    pairs = [numbers.get(key, -1) for key in itertools.pairwise(indices)]
    if any(number >= 0 for number in pairs):
        wanted = ~((low[:-1] & low[1:]) | (high[:-1] & high[1:]))
        around = before[:-1], after[:-1] & _named(pairs), after[1:]
        found += joined_surface(points, variance, around, resolution, wanted, pairs)
    return SurfaceSamples(
        np.concatenate([each.points for each in found], axis=1, dtype=np.float64),
        np.concatenate([each.variance for each in found], dtype=np.float64),
        [run for each in found for run in each.runs],
    )


def _links(
    stripes: Mapping[int, StripePoints], indices: list[int], pattern: range, join_height: float
) -> tuple[Mask, Mask]:
    """Columns (s, w) in which stripes are linked to the one before, and in which to the one after.

    Nowhere when the other was lost, everywhere beyond the pattern's ends: there nothing was ever going to look, so
    that nothing came back says nothing of the surface.
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
    return before, after


def _named(numbers: list[int]) -> Mask:
    """(n, 1) which of these are numbers of parts."""
    return np.array([[number >= 0] for number in numbers])
