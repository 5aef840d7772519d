"""Finds the stripes of one sweep in its frames: checks each frame, supplies a background, extracts by the method."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from guara_perception.arrays import Image
from guara_perception.methods import METHODS
from guara_perception.stripes.background import SweepBackground
from guara_perception.stripes.band import Band
from guara_perception.stripes.channels import OffRows, SharedFrame
from guara_perception.stripes.extract import unusable_frame
from guara_perception.stripes.profile import StripeProfile, bad_frame

# The channels of a whole laser-off frame take as long as those of the bands of this many stripes.
SHARED_FROM = 4


class StripeFinder:
    """Turns frame pairs into stripe profiles; a frame that cannot be used gives a profile that says why."""

    def __init__(self, method: str, size: tuple[int, int], step: int) -> None:
        """Prepare a sweep.

        Args:
            method: one of `guara_perception.methods.METHODS`.
            size: width and height of the calibrated camera's pictures [px].
            step: index difference of neighbouring stripes.
        """
        self._extract = METHODS[method].extract
        self._size = size
        self._background = SweepBackground(step)

    def find_all(self, frames: Sequence[tuple[int, tuple[int, int], Image, Image | None]]) -> list[StripeProfile]:
        """The stripes of some frame pairs.

        Args:
            frames: of each stripe its index; first and end row of the band in which it can appear; the picture with the
                laser on; and that with the laser off, or None: earlier frames of the sweep serve instead.
        """
        # For the time of this call only: later the same array may hold another picture.
        uses = Counter(id(off) for _, _, _, off in frames)
        shared = {
            id(off): SharedFrame(off) for _, _, _, off in frames if off is not None and uses[id(off)] >= SHARED_FROM
        }
        bands = [self._band(*frame, shared.get(id(frame[3]))) for frame in frames]
        found = iter(self._extract([band for band in bands if isinstance(band, Band)]))
        return [bad_frame(self._size[0], band) if isinstance(band, str) else next(found) for band in bands]

    def _band(
        self, index: int, rows: tuple[int, int], on: Image, off: Image | None, shared: SharedFrame | None
    ) -> Band | str:
        """What a stripe is sought in, or why it cannot be; `shared` is `off` where it serves other stripes as well."""
        width, height = self._size
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
        if off is not None:
            return Band(on[first:end], OffRows(off[first:end], shared, first), first)
        background = self._background.add(index, on, rows)
        return background.reason or Band.of(background.on, background.off, first)
