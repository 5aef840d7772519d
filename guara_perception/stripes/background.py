"""Background for scans without laser-off frames: the darker of two earlier frames of the same sweep."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from guara_perception.stripes.channels import channel_of
from guara_perception.stripes.judge import judge

Plane = npt.NDArray[Any]

# Stripes so many places before in the pattern do not touch this one in the picture; two, because each hides itself.
PLACES_BEFORE = (3, 6)


@dataclass(frozen=True, slots=True)
class Background:
    """What to subtract from a frame.

    Attributes:
        on: the rows of the band, reduced to the sweep's channel where `off` is.
        off: background of the same shape, None: estimate it from the frame itself.
        reason: why there is none although there should be, empty when all is well.
    """

    on: Plane
    off: Plane | None = None
    reason: str = ""


class SweepBackground:
    """Keeps one channel of the last few laser-on frames, so memory does not grow with the sweep.

    Which frames serve a stripe depends on its place alone. When one of them was lost, the stripe is given up rather
    than measured in another way: a lost frame may take knowledge away, never change it.
    """

    def __init__(self, step: int) -> None:
        """Start with nothing.

        Args:
            step: index difference of neighbouring stripes.
        """
        self._step = step
        self._planes: OrderedDict[int, Plane] = OrderedDict()
        self._channel: int | None = None
        self._first: int | None = None
        self._last = -1

    def add(self, index: int, on: npt.NDArray[Any], band: tuple[int, int]) -> Background:
        """Take a good laser-on frame and give its background.

        The channel is that in which the first stripe stands out most, and stays the same for the sweep. The first
        stripes, and those that come out of order, are served by an estimate from their own frame.

        Args:
            index: of the stripe.
            on: whole laser-on frame.
            band: rows in which the stripe is sought.
        """
        rows = slice(*band)
        if self._channel is None or self._first is None:
            self._channel = judge(on[rows], None).channel
            self._first = index
        plane = channel_of(on, self._channel)
        if np.may_share_memory(plane, on):
            # A camera of one channel may fill the same memory again.
            plane = plane.copy()
        out_of_order = index < self._last
        self._planes[index] = plane
        self._last = max(self._last, index)
        if len(self._planes) > max(PLACES_BEFORE) + 1:
            self._planes.popitem(last=False)
        needed = [index - places * self._step for places in PLACES_BEFORE]
        if out_of_order or min(needed) < self._first:
            return Background(on[rows])
        missing = [other for other in needed if other not in self._planes]
        if missing:
            return Background(
                on[rows], reason=f"no laser-off frame, and frame {missing[0]}, which would serve instead, was lost"
            )
        return Background(plane[rows], np.minimum(*(self._planes[other][rows] for other in needed)))
