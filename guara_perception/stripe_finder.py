"""Finds the stripes of one sweep in its frames: checks each frame, supplies a background, extracts by the method."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from guara_perception.methods import METHODS
from guara_perception.stripes.background import SweepBackground
from guara_perception.stripes.extract import unusable_frame
from guara_perception.stripes.profile import StripeProfile, bad_frame

Frame = npt.NDArray[Any]


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

    def find(self, index: int, band: tuple[int, int], on: Frame, off: Frame | None) -> StripeProfile:
        """The stripe of one frame pair.

        Args:
            index: of the stripe.
            band: first and end row in which it can appear.
            on: picture with the laser on.
            off: picture with the laser off, or None: earlier frames of the sweep serve instead.
        """
        width, height = self._size
        if not isinstance(on, np.ndarray) or on.dtype not in (np.uint8, np.uint16) or on.ndim not in (2, 3):
            given = f"{on.dtype} {on.shape}" if isinstance(on, np.ndarray) else type(on).__name__
            return bad_frame(width, f"the frame is {given}, it must be a uint8 or uint16 picture")
        if on.shape[:2] != (height, width):
            return bad_frame(
                width,
                f"the frame is {on.shape[1]}x{on.shape[0]} px, the calibrated camera gives {width}x{height}",
            )
        if on.ndim == 3 and on.shape[2] not in (1, 3):
            return bad_frame(width, f"the frame has {on.shape[2]} channels, it must have 1 or 3")
        first, end = band
        if end <= first:
            return bad_frame(width, "the stripe lies outside the camera's view at this stance")
        reason = unusable_frame(on[first:end], off, on.shape)
        if reason:
            return bad_frame(width, reason)
        if off is None:
            background = self._background.add(index, on, band)
            if background.reason:
                return bad_frame(width, background.reason)
            on, off = background.on, background.off
        return self._extract(on[first:end], None if off is None else off[first:end], first)
