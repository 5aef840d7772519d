"""The surface of a scan: of each stripe, and between each stripe and the next."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np
import numpy.typing as npt

from guara_perception.ranging.stripe_points import StripePoints
from guara_perception.ranging.surface import confirmed_points, joined_surface, linked_columns
from guara_perception.terrain.raster import PartSamples

Key = tuple[int, int]
Mask = npt.NDArray[np.bool_]


def scan_surface(
    stripes: Mapping[int, StripePoints], pattern: range, join_height: float, resolution: float
) -> Iterator[tuple[Key, PartSamples]]:
    """Surface of every stripe and of every pair of neighbouring stripes.

    Args:
        stripes: points by index.
        pattern: indices of the stripes of the scan's mode; neighbours are those next to each other in it.
        join_height: largest height difference of one surface [m].
        resolution: edge of the cells that will be filled [m].

    Yields:
        ((index, index), surface of that stripe's own points) and ((index, next index), surface between the two).
    """
    links = Links(stripes, pattern, join_height)
    for index in sorted(stripes):
        for key in ((index, index), (index, index + pattern.step)):
            if key[1] in stripes:
                yield key, surface_of(stripes, [key], links, resolution)


class Links:
    """Where neighbouring stripes lie on one surface; each pair is looked at once."""

    def __init__(self, stripes: Mapping[int, StripePoints], pattern: range, join_height: float) -> None:
        """Start.

        Args:
            stripes: points by index; more may come later, none may change.
            pattern: indices of the stripes of the scan's mode.
            join_height: largest height difference of one surface [m].
        """
        self._stripes = stripes
        self._join_height = join_height
        self._pattern = pattern
        self._known: dict[int, Mask] = {}

    @property
    def step(self) -> int:
        """Index difference of neighbouring stripes."""
        return self._pattern.step

    def look_at(self, indices: Iterable[int]) -> None:
        """Link stripes and the next of each where both are there, all in one go."""
        new = [i for i in indices if i not in self._known and i in self._stripes and i + self.step in self._stripes]
        if new:
            stripes = [self._stripes[i + on] for on in (0, self.step) for i in new]
            heights = np.array([stripe.points[:, 2] for stripe in stripes]).reshape(2, len(new), -1)
            strengths = np.array([stripe.strength for stripe in stripes]).reshape(heights.shape)
            self._known.update(zip(new, linked_columns(heights, strengths, self._join_height), strict=True))

    def after(self, indices: Sequence[int], width: int) -> Mask:
        """Columns (s, w) in which stripes and the next of each are linked; one of the two must be there.

        Nowhere when the other was lost, everywhere beyond the pattern's ends: there nothing was ever going to look,
        so that nothing came back says nothing of the surface.
        """
        return np.array([self._known[i] if i in self._known else self._unseen(i, width) for i in indices])

    def _unseen(self, index: int, width: int) -> Mask:
        is_beyond = index not in self._pattern or index + self.step not in self._pattern
        return np.full(width, is_beyond)


def surface_of(
    stripes: Mapping[int, StripePoints],
    keys: Sequence[Key],
    links: Links,
    resolution: float,
    y_range: tuple[float, float] = (-np.inf, np.inf),
) -> PartSamples:
    """Surface of stripes, their points that the neighbours on both sides confirm, and of pairs, the lines between.

    Args:
        stripes: points by index.
        keys: (index, index) of stripes and (index, next index) of pairs; each is a part, numbered in this order.
        links: of these stripes.
        resolution: edge of the cells that will be filled [m].
        y_range: points and lines wholly on one side of it are not asked for [m].
    """
    numbers = {key: number for number, key in enumerate(keys)}
    indices = sorted({index for key in keys for index in key})
    width = len(stripes[indices[0]].variance)
    # Coordinates apart, each in one piece of memory: several times faster than points in rows.
    points = np.empty((3, len(indices), width), dtype=np.float32)
    for place, index in enumerate(indices):
        points[:, place] = stripes[index].points.T
    variance = np.array([stripes[index].variance for index in indices])
    links.look_at({*indices, *(index - links.step for index in indices)})
    before, after = (links.after([index - back for index in indices], width) for back in (links.step, 0))
    low, high = points[1] < y_range[0], points[1] > y_range[1]
    own = [numbers.get((index, index), -1) for index in indices]
    confirmed = before & after & ~(low | high) & _named(own)
    found = [confirmed_points(points, variance, confirmed, own)]
    pairs = [numbers.get(key, -1) for key in itertools.pairwise(indices)]
    if any(number >= 0 for number in pairs):
        wanted = ~((low[:-1] & low[1:]) | (high[:-1] & high[1:]))
        around = before[:-1], after[:-1] & _named(pairs), after[1:]
        found += joined_surface(points, variance, around, resolution, wanted, pairs)
    return PartSamples(
        np.concatenate([each.points for each in found], axis=1, dtype=np.float64),
        np.concatenate([each.variance for each in found], dtype=np.float64),
        [run for each in found for run in each.runs],
    )


def _named(numbers: list[int]) -> Mask:
    """(n, 1) which of these are numbers of parts."""
    return np.array([[number >= 0] for number in numbers])
