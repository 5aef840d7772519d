"""The surface of a scan: of each stripe, and between each stripe and the next."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
import numpy.typing as npt

from guara_perception.ranging.stripe_points import StripePoints
from guara_perception.ranging.surface import Surface, confirmed_points, joined_surface, linked_columns

Key = tuple[int, int]


def scan_surface(
    stripes: Mapping[int, StripePoints], pattern: range, join_height: float, resolution: float
) -> Iterator[tuple[Key, Surface]]:
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
        yield (index, index), stripe_surface(stripes, index, pattern, join_height)
        if index + pattern.step in stripes:
            yield (index, index + pattern.step), pair_surface(stripes, index, pattern, join_height, resolution)


def stripe_surface(stripes: Mapping[int, StripePoints], index: int, pattern: range, join_height: float) -> Surface:
    """The points of one stripe that its neighbours on both sides confirm."""
    stripe, step = stripes[index], pattern.step
    before = _links(stripes, (index - step, index), pattern, join_height)
    after = _links(stripes, (index, index + step), pattern, join_height)
    return confirmed_points(stripe.points, stripe.variance, before, after)


def pair_surface(
    stripes: Mapping[int, StripePoints], index: int, pattern: range, join_height: float, resolution: float
) -> Surface:
    """The surface between a stripe and the next; both must be there."""
    step = pattern.step
    first, second = stripes[index], stripes[index + step]
    return joined_surface(
        (first.points, second.points),
        (first.variance, second.variance),
        (
            _links(stripes, (index - step, index), pattern, join_height),
            _links(stripes, (index, index + step), pattern, join_height),
            _links(stripes, (index + step, index + 2 * step), pattern, join_height),
        ),
        resolution,
    )


def _links(
    stripes: Mapping[int, StripePoints], pair: tuple[int, int], pattern: range, join_height: float
) -> npt.NDArray[np.bool_]:
    """Where two neighbours lie on one surface: nowhere when one of them was lost, everywhere beyond the pattern's ends.

    Beyond its ends nothing was ever going to look, so that nothing came back says nothing of the surface there.
    """
    columns = len(stripes[pair[0] if pair[0] in stripes else pair[1]].points) if set(pair) & set(stripes) else 0
    if pair[0] not in pattern or pair[1] not in pattern:
        return np.ones(columns, dtype=bool)
    if pair[0] not in stripes or pair[1] not in stripes:
        return np.zeros(columns, dtype=bool)
    return linked_columns(stripes[pair[0]], stripes[pair[1]], join_height)
