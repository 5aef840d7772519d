"""Links between neighbouring stripes: the image columns in which two of them lie on one surface.

Two neighbouring stripes of the pattern confirm each other in an image column if their heights differ by less than
`join_height`. A stripe can confirm returns of another, never create them: fewer stripes give less surface.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from guara_perception.arrays import Array, Mask
from guara_perception.ranging.stripe_points import StripePoints

# Key of a swath: (index, index) for one stripe, (index, next index) for the surface between two neighbours.
Key = tuple[int, int]
# Ratio of two strengths below which the weaker return may be cut by an edge or a shadow ...
WEAK_RATIO = 0.4
# ... so that the two are joined only if their heights differ by less than this.
WEAK_JOIN_HEIGHT_M = 0.0015
EVERYWHERE = (-math.inf, math.inf)


def surface_keys(stripes: Collection[int], pattern: range) -> list[Key]:
    """(index, index) of every stripe and (index, next index) of every pair of neighbours of the pattern, in order."""
    return [key for k in sorted(stripes) for key in ((k, k), (k, k + pattern.step)) if key[1] in stripes]


@dataclass(frozen=True, slots=True)
class Links:
    """Points of some stripes and their links to neighbouring ones.

    Attributes:
        indices: indices of s stripes.
        points: (3, s, w) float32 points of these stripes.
        confirmed: (s, w) requested points that the stripes on both sides confirm.
        own: s numbers of swaths of the stripes, -1 for those not requested.
        links: three (s - 1, w), see `surface.joined_surface`.
        wanted: (s - 1, w) columns in which lines are requested.
        pairs: s - 1 numbers of swaths of the pairs, -1 for those not requested.
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
    """Points and links of the stripes in `keys`; arguments as of `surface_of`."""
    numbers = {key: number for number, key in enumerate(keys)}
    indices = sorted({index for key in keys for index in key})
    # Each coordinate contiguous in memory: several times faster than one point after the other.
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
        before & after & ~(low | high) & _is_requested(own),
        own,
        (before[:-1], after[:-1] & _is_requested(pairs), after[1:]),
        ~((low[:-1] & low[1:]) | (high[:-1] & high[1:])),
        pairs,
    )


def linked_columns(heights: tuple[Array, Array], strengths: tuple[Array, Array], join_height: float) -> Mask:
    """Columns in which two neighbouring stripes lie on one surface.

    A stripe that is cut by an edge or a shadow is weak and displaced: where one of the two returns is much weaker than
    the other, their heights must agree more closely.

    Args:
        heights: two (..., w), of neighbouring stripes [m].
        strengths: two (..., w), strengths of their returns [grey levels].
        join_height: largest height difference of one surface [m].

    Returns:
        (..., w) bool, True where both have a point and the heights differ by less than the difference allowed.
    """
    with np.errstate(invalid="ignore"):
        weaker, stronger = np.minimum(*strengths), np.maximum(*strengths)
        allowed = np.where(weaker < WEAK_RATIO * stronger, min(WEAK_JOIN_HEIGHT_M, join_height), join_height)
        return np.asarray(np.abs(heights[1] - heights[0]) < allowed)


def _links(
    stripes: Mapping[int, StripePoints], indices: list[int], pattern: range, join_height: float, parted: Collection[Key]
) -> tuple[Mask, Mask]:
    """Masks (s, w) of the columns in which each stripe is linked to the previous one, and to the next one.

    No column if that stripe was lost or the two are parted. All columns at an end of the pattern: no stripe is fired
    there that could contradict the surface.
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
    """Mask (n, 1) of the requested swaths, whose numbers are not -1."""
    return np.array([number >= 0 for number in numbers], dtype=bool)[:, None]
