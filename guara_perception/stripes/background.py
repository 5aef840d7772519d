"""Background for scans without laser-off frames: the darker of two earlier frames of the same sweep."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass

import numpy as np

from guara_perception.arrays import Image
from guara_perception.stripes.band import channel_of
from guara_perception.stripes.laser_light import judge

# Earlier stripes of the pattern, by how many before this one, that do not touch it in the picture; two, because each
# hides what lies under itself.
STRIPES_BEFORE = (3, 6)


@dataclass(frozen=True, slots=True)
class Background:
    """What to subtract from a frame.

    Attributes:
        on: the rows of the band, reduced to the sweep's channel where `off` is.
        off: background of the same shape, None: estimate it from the frame itself.
        reason: why there is none although there should be, empty when all is well.
    """

    on: Image
    off: Image | None = None
    reason: str = ""


class SweepBackground:
    """Keeps one channel of the last few laser-on frames, so memory does not grow with the sweep.

    Which frames serve a stripe depends on its index alone. When one of them was lost, the stripe is given up rather
    than measured in another way: a lost frame may take knowledge away, never change it.
    """

    def __init__(self, stride: int) -> None:
        """Start with nothing.

        Args:
            stride: index difference of neighbouring stripes.
        """
        self._stride = stride
        self._kept: OrderedDict[int, Image] = OrderedDict()
        self._channel: int | None = None
        self._first: int | None = None
        self._last = -1

    def add(self, index: int, on: Image, band: tuple[int, int]) -> Background:
        """Take a good laser-on frame and give its background.

        The channel is that in which the first stripe stands out most, and stays the same for the sweep. The first
        stripes, and those that come out of order, are served by an estimate from their own frame.

        Args:
            index: index of the stripe.
            on: whole laser-on frame.
            band: first and end row between which the stripe can appear.
        """
        rows = slice(*band)
        if self._channel is None or self._first is None:
            self._channel = judge(on[rows], None).channel
            self._first = index
        kept = channel_of(on, self._channel)
        if np.may_share_memory(kept, on):
            # A camera of one channel may fill the same memory again.
            kept = kept.copy()
        out_of_order = index < self._last
        self._kept[index] = kept
        self._last = max(self._last, index)
        if len(self._kept) > max(STRIPES_BEFORE) + 1:
            self._kept.popitem(last=False)
        needed = [index - before * self._stride for before in STRIPES_BEFORE]
        if out_of_order or min(needed) < self._first:
            return Background(on[rows])
        missing = [other for other in needed if other not in self._kept]
        if missing:
            return Background(
                on[rows], reason=f"no laser-off frame, and frame {missing[0]}, which would serve instead, was lost"
            )
        return Background(kept[rows], np.minimum(*(self._kept[other][rows] for other in needed)))
