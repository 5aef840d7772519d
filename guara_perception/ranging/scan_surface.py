"""The surface of a scan: of each stripe, and between each stripe and the next."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
import numpy.typing as npt

from guara_perception.ranging.stripe_points import StripePoints
from guara_perception.ranging.surface import Surface, confirmed_points, joined_surface, linked_columns

Key = tuple[int, int]
Mask = npt.NDArray[np.bool_]


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
    links = Links(stripes, pattern, join_height)
    for index in sorted(stripes):
        yield (index, index), stripe_surface(stripes, index, links)
        if index + pattern.step in stripes:
            yield (index, index + pattern.step), pair_surface(stripes, index, links, resolution)


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

    def after(self, index: int) -> Mask:
        """Columns in which a stripe and the next are linked; one of the two must be there.

        Nowhere when the other was lost, everywhere beyond the pattern's ends: there nothing was ever going to look,
        so that nothing came back says nothing of the surface.
        """
        following = index + self._pattern.step
        if index in self._known:
            return self._known[index]
        first, second = self._stripes.get(index), self._stripes.get(following)
        if first is not None and second is not None:
            linked = self._known[index] = linked_columns(first, second, self._join_height)
            return linked
        there = first if first is not None else second
        columns = 0 if there is None else len(there.points)
        is_beyond = index not in self._pattern or following not in self._pattern
        return np.full(columns, is_beyond)

    @property
    def step(self) -> int:
        """Index difference of neighbouring stripes."""
        return self._pattern.step

    def before(self, index: int) -> Mask:
        """Columns in which a stripe and the one before it are linked."""
        return self.after(index - self._pattern.step)


def stripe_surface(stripes: Mapping[int, StripePoints], index: int, links: Links) -> Surface:
    """The points of one stripe that its neighbours on both sides confirm."""
    stripe = stripes[index]
    return confirmed_points(stripe.points, stripe.variance, links.before(index), links.after(index))


def pair_surface(
    stripes: Mapping[int, StripePoints], index: int, links: Links, resolution: float, wanted: Mask | None = None
) -> Surface:
    """The surface between a stripe and the next; both must be there.

    Args:
        stripes: points by index.
        index: of the first.
        links: of these stripes.
        resolution: edge of the cells that will be filled [m].
        wanted: (w,) columns that are asked for; None = all.
    """
    following = index + links.step
    first, second = stripes[index], stripes[following]
    return joined_surface(
        (first.points, second.points),
        (first.variance, second.variance),
        (links.before(index), links.after(index), links.after(following)),
        resolution,
        wanted,
    )
