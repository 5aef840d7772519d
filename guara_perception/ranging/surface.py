"""Surface of a scan: points of stripes that both neighbours confirm, and lines between neighbours that agree."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence

import numpy as np

from guara_perception.arrays import Array, Index, Mask
from guara_perception.ranging.lines import Lines, sample_count, shares
from guara_perception.ranging.links import EVERYWHERE, Key, links_of
from guara_perception.ranging.stripe_points import StripePoints
from guara_perception.terrain.assessment.raster import SurfaceSamples


def confirmed_points(points: Array, variance: Array, confirmed: Mask, swaths: Sequence[int]) -> SurfaceSamples:
    """Samples at the points of stripes that lie within a surface.

    Args:
        points: (3, s, w) points of the stripes.
        variance: (s, w) variance of the heights [m^2].
        confirmed: (s, w) linked to the previous and to the next stripe, and requested.
        swaths: s numbers of swaths, one for each stripe.
    """
    inside = confirmed & np.isfinite(points[2])
    indices = np.flatnonzero(inside)
    runs = [(swath, length) for swath, length in zip(swaths, inside.sum(axis=1).tolist(), strict=True) if length]
    return SurfaceSamples(points.reshape(3, -1).take(indices, axis=1), variance.take(indices), runs)


def joined_surface(
    points: Array,
    variance: Array,
    links: tuple[Mask, Mask, Mask],
    resolution: float,
    wanted: Mask,
    swaths: Sequence[int],
) -> list[SurfaceSamples]:
    """Sample the lines between each stripe and the next in the columns in which the two are linked.

    Where the surface ends at one of the two, the line is shortened by OPEN_END_M at that end; samples cut off are NaN.

    Args:
        points: (3, s, w) points of the stripes, two or more.
        variance: (s, w) variance of their heights [m^2].
        links: (s - 1, w) links of the first stripe of each pair to the one before it, of the two stripes, and of the
            second stripe to the one after it.
        resolution: edge of the cells that will be filled [m].
        wanted: (s - 1, w) requested columns.
        swaths: s - 1 numbers of swaths, one for each pair.

    Returns:
        Samples of all pairs, grouped by the number of samples of a line.
    """
    joined = []
    width = variance.shape[1]
    for lines, indices, runs in _lines(points, links, resolution, wanted, swaths):
        share, of_first, of_last = shares(lines.number)
        samples = share * lines.difference[:, None]
        samples += lines.first[:, None]
        samples[2].reshape(-1)[lines.cut()] = np.nan
        along = of_first * variance.take(indices).astype(np.float64)
        along += of_last * variance.take(indices + width).astype(np.float64)
        joined.append(SurfaceSamples(samples.reshape(3, -1), along.reshape(-1), runs * lines.number))
    return joined


def _lines(
    points: Array,
    links: tuple[Mask, Mask, Mask],
    resolution: float,
    wanted: Mask,
    swaths: Sequence[int],
) -> Iterator[tuple[Lines, Index, list[tuple[int, int]]]]:
    """The lines of `joined_surface`, the flat index (c,) of the point at which each begins, and the runs of swaths."""
    before, between, after = links
    difference = points[:, 1:] - points[:, :-1]
    # Sample counts must not depend on the requested columns.
    numbers = sample_count(difference, between, resolution)
    lines = between & wanted
    lengths = lines.sum(axis=1).tolist()
    runs = [(n, (swath, length)) for n, swath, length in zip(numbers, swaths, lengths, strict=True) if length]
    for number in sorted({n for n, _ in runs}):
        alike = [n == number for n in numbers]
        indices = np.flatnonzero(lines if all(alike) else lines & np.array(alike)[:, None])
        alike_lines = Lines(
            points.reshape(3, -1).take(indices, axis=1).astype(np.float64),
            difference.reshape(3, -1).take(indices, axis=1).astype(np.float64),
            ~before.take(indices),
            ~after.take(indices),
            number,
        )
        yield alike_lines, indices, [run for n, run in runs if n == number]


def surface_of(
    stripes: Mapping[int, StripePoints],
    keys: Sequence[Key],
    pattern: range,
    join_height: float,
    resolution: float,
    y_range: tuple[float, float] = EVERYWHERE,
    parted: Collection[Key] = (),
) -> SurfaceSamples:
    """Surface of stripes (points that both neighbours confirm) and of pairs of stripes (lines between them).

    Args:
        stripes: points by index.
        keys: (index, index) of stripes and (index, next index) of pairs; each is a swath, numbered in this order.
        pattern: indices of the stripes of the scan's mode.
        join_height: largest height difference of one surface [m].
        resolution: edge of the cells that will be filled [m].
        y_range: range of y outside which points and lines are omitted [m].
        parted: (index, next index) of neighbours that do not confirm each other, whatever their heights.
    """
    seen = links_of(stripes, keys, pattern, join_height, y_range, parted)
    variance = np.array([stripes[index].variance for index in seen.indices])
    found = [
        confirmed_points(seen.points, variance, seen.confirmed, seen.own),
        *joined_surface(seen.points, variance, seen.links, resolution, seen.wanted, seen.pairs),
    ]
    return SurfaceSamples(
        np.concatenate([each.points for each in found], axis=1, dtype=np.float64),
        np.concatenate([each.variance for each in found], dtype=np.float64),
        [run for each in found for run in each.runs],
    )


def surface_lines(
    stripes: Mapping[int, StripePoints],
    keys: Sequence[Key],
    pattern: range,
    join_height: float,
    resolution: float,
    y_range: tuple[float, float] = EVERYWHERE,
) -> Iterator[tuple[Lines, Index]]:
    """Surface of `surface_of` as the lines on which its samples lie; a point is a line of one sample.

    Yields lines, and the positions of the lines that are followed by that of the next image column.
    """
    seen = links_of(stripes, keys, pattern, join_height, y_range)
    indices = np.flatnonzero(seen.confirmed & np.isfinite(seen.points[2]))
    points = seen.points.reshape(3, -1).take(indices, axis=1)
    is_open = np.zeros(indices.size, dtype=bool)
    width = seen.points.shape[2]
    yield Lines(points.astype(np.float64), np.zeros(points.shape), is_open, is_open, 1), _neighbours(indices, width)
    for lines, begins, _ in _lines(seen.points, seen.links, resolution, seen.wanted, seen.pairs):
        yield lines, _neighbours(begins, width)


def _neighbours(indices: Index, width: int) -> Index:
    """Positions of those flat indices (stripe, image column) that the next column of the same stripe follows."""
    return np.flatnonzero((np.diff(indices) == 1) & ((indices[:-1] + 1) % width > 0))
