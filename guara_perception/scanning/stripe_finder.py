"""Stripe extraction from the frames of one sweep: frame checks, background, extraction by the chosen method."""

from __future__ import annotations

from collections import OrderedDict
from functools import partial

import numpy as np

from guara_perception.arrays import Image
from guara_perception.exceptions import InvalidInput
from guara_perception.ranging.paper import Literal
from guara_perception.stripes.band import (
    Band,
    FramePair,
    StripeProfile,
    bad_frame,
    channel_of,
    clearest_channel,
    is_raw_bayer,
    picture_fault,
    unusable_frame,
)
from guara_perception.stripes.paper import check_threshold, extract_paper
from guara_perception.stripes.precise import extract_precise

# Offsets of the two earlier frames that form the background of a stripe [stripes]. The stripes in these frames are too
# far away to overlap it or each other, so the minimum of the two frames contains no stripe.
STRIPES_BEFORE = (3, 6)


class StripeFinder:
    """Extractor of stripe profiles from frame pairs; the profile of an unusable frame states the reason."""

    def __init__(self, method: str, size: tuple[int, int], stride: int, threshold: float | None = None) -> None:
        """Start a sweep.

        Args:
            method: one of `guara_perception.scanning.stripe_finder.METHODS`.
            size: width and height of the calibrated camera's images [px].
            stride: index difference of neighbouring stripes.
            threshold: threshold of the paper's binarisation, as in `extract_paper`; not used by the method "precise".
        """
        self._extract = extract_precise if METHODS[method] is None else partial(extract_paper, threshold=threshold)
        self._size = size
        self._background = SweepBackground(stride)

    def find(self, pair: FramePair, rows: tuple[int, int]) -> StripeProfile:
        """Find the stripe of a frame pair, between the image rows (first, end) in which it can appear."""
        band = self._band(pair, rows)
        return bad_frame(self._size[0], band) if isinstance(band, str) else self._extract(band)

    def _band(self, pair: FramePair, rows: tuple[int, int]) -> Band | str:
        """Band of a stripe, or the reason why it has none."""
        (width, height), on, off = self._size, pair.on, pair.off
        if fault := picture_fault(on):
            return f"the frame is {fault}"
        if on.shape[:2] != (height, width):
            return f"the frame is {on.shape[1]}x{on.shape[0]} px, the calibration is for {width}x{height} px"
        first, end = rows
        if end <= first:
            return "the stripe lies outside the camera's view at this stance"
        reason = unusable_frame(on[first:end], off, on.shape)
        if reason:
            return reason
        if is_raw_bayer(on[first:end], None if off is None else off[first:end]):
            return "the frame is raw Bayer data: use its red pixels only, or convert it to BGR (cv2.demosaicing)"
        if off is not None:
            return Band(on[first:end], off[first:end], first)
        return self._background.add(pair.index, on, rows)


class SweepBackground:
    """Backgrounds of a sweep without laser-off frames, from one channel of the last few laser-on frames.

    The background of a stripe is the minimum of two earlier frames, at the index offsets STRIPES_BEFORE. If one of them
    was lost or unusable, the stripe is rejected. The first stripes, and stripes out of order, get no background but are
    not rejected (see `add`).
    """

    def __init__(self, stride: int) -> None:
        """Start without frames.

        Args:
            stride: index difference of neighbouring stripes.
        """
        self._stride = stride
        self._kept: OrderedDict[int, Image] = OrderedDict()
        self._channel: int | None = None
        self._first: int | None = None
        self._last = -1

    def add(self, index: int, on: Image, rows: tuple[int, int]) -> Band | str:
        """Add a usable laser-on frame; return its band, or the reason why the stripe is rejected.

        The channel in which the first stripe stands out most from the noise is used for the whole sweep. The first
        stripes, and stripes out of order, get a band with all channels and no background; the background is then
        estimated from the frame itself.

        Args:
            index: index of the stripe.
            on: whole laser-on frame.
            rows: image rows (first, end) between which the stripe can appear.
        """
        band = slice(*rows)
        if self._channel is None or self._first is None:
            self._channel = clearest_channel(on[band])
            self._first = index
        kept = channel_of(on, self._channel)
        if np.may_share_memory(kept, on):
            # A view of a monochrome frame, which the camera may overwrite with the next image.
            kept = kept.copy()
        out_of_order = index < self._last
        self._kept[index] = kept
        self._last = max(self._last, index)
        if len(self._kept) > max(STRIPES_BEFORE) + 1:
            self._kept.popitem(last=False)
        needed = [index - before * self._stride for before in STRIPES_BEFORE]
        if out_of_order or min(needed) < self._first:
            return Band(on[band], None, rows[0])
        missing = [other for other in needed if other not in self._kept]
        if missing:
            return (
                f"no laser-off frame, and the frame of stripe {missing[0]}, one of the two earlier frames that replace "
                "it, is missing or unusable"
            )
        return Band(kept[band], np.minimum(*(self._kept[other][band] for other in needed)), rows[0])


# For each method, the equations of the paper (docs/paper.md) that are used as printed; None = triangulation instead of
# the paper's equations.
METHODS: dict[str, Literal | None] = {
    # Matched filter, triangulation with the calibrated laser planes.
    "precise": None,
    # The paper's eqs. 7 to 21, corrected.
    "paper": Literal(),
    # As "paper", with eq. 8 solved in one iteration, as printed.
    "paper-literal-lens": Literal(lens=True),
    # As "paper", with eqs. 20 and 21 about the centre of the area, as printed.
    "paper-literal-ortho": Literal(ortho=True),
}


def check_method(name: str, threshold: float | None = None) -> None:
    """Reject an unknown method, an invalid threshold, and a threshold for a method that uses none.

    Raises:
        InvalidInput: the method or the threshold is rejected.
    """
    if name not in METHODS:
        raise InvalidInput(f"method is {name!r}, allowed: {', '.join(METHODS)}")
    check_threshold(threshold, name, has_threshold=METHODS[name] is not None)
