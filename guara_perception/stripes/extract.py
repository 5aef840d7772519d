"""`extract_stripe`: the stripe of one picture by a chosen method."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import cv2
import numpy as np

from guara_perception.arrays import Image
from guara_perception.exceptions import InvalidInput
from guara_perception.stripes.band import Band, StripeProfile, bad_frame, picture_fault, unusable_frame
from guara_perception.stripes.paper import check_threshold, extract_paper
from guara_perception.stripes.precise import extract_precise

Extract = Callable[[Sequence[Band]], list[StripeProfile]]
METHODS: dict[str, Extract] = {"precise": extract_precise, "paper": extract_paper}


def extract_stripe(
    on: Image,
    off: Image | None = None,
    along: str = "columns",
    band: tuple[int, int] | None = None,
    method: str = "precise",
    threshold: float | None = None,
) -> StripeProfile:
    """Find the laser stripe in one picture.

    Args:
        on: (h, w) or (h, w, 3) BGR as OpenCV reads it, uint8 or uint16, laser on.
        off: the same view with the laser off; None = the background is estimated from `on`.
        along: "columns": the stripe crosses the columns, one position (a row) per column; "rows": one position
            (a column) per row.
        band: (first, end) rows that are searched, or columns for along="rows"; None = the whole picture.
        method: one of METHODS.
        threshold: of the binarisation of "paper" [grey levels of 8 bits]; None = chosen by the picture.

    Returns:
        A StripeProfile with w entries (h for along="rows"). A picture that cannot be used (blank, white,
        another size or type than its off frame) gives FRAME_BAD in every entry and says why.

    Raises:
        InvalidInput: `on` is no picture of 8 by 8 pixels or more, or an argument is not one of those allowed.
    """
    if method not in METHODS:
        raise InvalidInput(f"method is {method!r}, allowed: {', '.join(METHODS)}")
    check_threshold(threshold, method, has_threshold=method == "paper")
    if along not in ("columns", "rows"):
        raise InvalidInput(f"along is {along!r}, allowed: 'columns', 'rows'")
    if fault := picture_fault(on):
        raise InvalidInput(f"the picture is {fault}")
    if min(on.shape[:2]) < 8:
        raise InvalidInput(f"the picture is {on.shape}, it must have 8 pixels or more each way")
    if along == "rows":
        on, off = _turned(on), _turned(off) if isinstance(off, np.ndarray) and off.ndim >= 2 else off
    height, width = on.shape[:2]
    first, end = (0, height) if band is None else (int(band[0]), int(band[1]))
    if not 0 <= first < end <= height or end - first < 8:
        raise InvalidInput(f"band is {band}, it must be (first, end) with 8 lines or more inside 0 ... {height}")
    reason = unusable_frame(on[first:end], None if off is None else off, on.shape)
    if reason:
        return bad_frame(width, reason)
    bands = [Band(on[first:end], None if off is None else off[first:end], first)]
    return (METHODS[method](bands) if threshold is None else extract_paper(bands, threshold))[0]


def _turned(picture: Image) -> Image:
    """The picture with its rows as columns; a valid one in contiguous memory, which is quicker to read."""
    turned = picture.swapaxes(0, 1)
    if picture.dtype not in (np.uint8, np.uint16) or picture.ndim > 3:
        return turned
    return np.asarray(cv2.transpose(picture)).reshape(turned.shape)
