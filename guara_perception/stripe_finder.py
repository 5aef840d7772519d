"""Finds the stripes of one sweep in its frames: checks each frame, supplies a background, extracts by the method."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np

from guara_perception.frame_pair import FramePair
from guara_perception.methods import METHODS
from guara_perception.stripes.background import SweepBackground
from guara_perception.stripes.band import Band, OffRows, SharedFrame
from guara_perception.stripes.extract import unusable_frame
from guara_perception.stripes.glance import is_raw_bayer
from guara_perception.stripes.profile import StripeProfile, bad_frame

# Cutting out the channels of a whole laser-off frame takes as long as for the bands of this number of stripes.
SHARED_FROM = 4


class StripeFinder:
    """Turns frame pairs into stripe profiles; a frame that cannot be used gives a profile that says why."""

    def __init__(self, method: str, size: tuple[int, int], stride: int) -> None:
        """Prepare a sweep.

        Args:
            method: one of `guara_perception.methods.METHODS`.
            size: width and height of the calibrated camera's pictures [px].
            stride: index difference of neighbouring stripes.
        """
        self._extract = METHODS[method].extract
        self._size = size
        self._background = SweepBackground(stride)

    def find_all(self, pairs: Sequence[FramePair], rows: Mapping[int, tuple[int, int]]) -> list[StripeProfile]:
        """The stripes of some frame pairs.

        Args:
            pairs: one frame pair per stripe.
            rows: first and end row between which each stripe can appear, by its index.
        """
        # For the time of this call only: later the same array may hold another picture.
        uses = Counter(id(pair.off) for pair in pairs)
        shared = {
            id(pair.off): SharedFrame(pair.off)
            for pair in pairs
            if pair.off is not None and uses[id(pair.off)] >= SHARED_FROM
        }
        bands = [self._band(pair, rows[pair.index], shared.get(id(pair.off))) for pair in pairs]
        found = iter(self._extract([band for band in bands if isinstance(band, Band)]))
        return [bad_frame(self._size[0], band) if isinstance(band, str) else next(found) for band in bands]

    def _band(self, pair: FramePair, rows: tuple[int, int], shared: SharedFrame | None) -> Band | str:
        """The band of a stripe, or why there is none; `shared` is its laser-off frame where that serves others too."""
        (width, height), on, off = self._size, pair.on, pair.off
        if not isinstance(on, np.ndarray) or on.dtype not in (np.uint8, np.uint16) or on.ndim not in (2, 3):
            given = f"{on.dtype} {on.shape}" if isinstance(on, np.ndarray) else type(on).__name__
            return f"the frame is {given}, it must be a uint8 or uint16 picture"
        if on.shape[:2] != (height, width):
            return f"the frame is {on.shape[1]}x{on.shape[0]} px, the calibrated camera gives {width}x{height}"
        if on.ndim == 3 and on.shape[2] not in (1, 3):
            return f"the frame has {on.shape[2]} channels, it must have 1 or 3"
        first, end = rows
        if end <= first:
            return "the stripe lies outside the camera's view at this stance"
        reason = unusable_frame(on[first:end], off, on.shape)
        if reason:
            return reason
        if is_raw_bayer(on[first:end], None if off is None else off[first:end]):
            return "the frame is raw Bayer data taken as grey: take its red pixels, or make it BGR (cv2.demosaicing)"
        if off is not None:
            return Band(on[first:end], OffRows(off[first:end], shared, first), first)
        background = self._background.add(pair.index, on, rows)
        return background.reason or Band.of(background.on, background.off, first)
