"""Extraction of the stripe from one image, by a chosen method."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from guara_perception.arrays import Image
from guara_perception.exceptions import InvalidInput
from guara_perception.stripes.band import Band, StripeProfile, bad_frame, picture_fault, unusable_frame
from guara_perception.stripes.paper import check_threshold, extract_paper
from guara_perception.stripes.precise import extract_precise

METHODS: dict[str, Callable[[Band], StripeProfile]] = {"precise": extract_precise, "paper": extract_paper}


def extract_stripe(
    on: Image,
    off: Image | None = None,
    along: str = "columns",
    band: tuple[int, int] | None = None,
    method: str = "precise",
    threshold: float | None = None,
) -> StripeProfile:
    """Find the laser stripe in one image.

    Args:
        on: laser-on image, (h, w) or (h, w, 3) BGR as OpenCV reads it, uint8 or uint16.
        off: laser-off image of the same view; None = estimate the background from `on`.
        along: "columns": the stripe crosses the columns and has one position (a row) per column; "rows": the stripe
            crosses the rows and has one position (a column) per row.
        band: (first, end) rows to search, or columns for along="rows"; None = the whole image.
        method: one of METHODS.
        threshold: binarisation threshold of the method "paper" [8-bit grey levels]; None = derived from the image.

    Returns:
        StripeProfile with w entries (h entries for along="rows"). If the images cannot be used, for instance because
        `on` is blank or white or `off` has another size or type, every entry is FRAME_BAD and `reason` states why.

    Raises:
        InvalidInput: `on` is not an image of 8 x 8 pixels or more, or an argument has a value that is not allowed.
    """
    if method not in METHODS:
        raise InvalidInput(f"method is {method!r}, allowed: {', '.join(METHODS)}")
    check_threshold(threshold, method, has_threshold=method == "paper")
    if along not in ("columns", "rows"):
        raise InvalidInput(f"along is {along!r}, allowed: 'columns', 'rows'")
    if fault := picture_fault(on):
        raise InvalidInput(f"the picture is {fault}")
    if min(on.shape[:2]) < 8:
        raise InvalidInput(f"the picture has shape {on.shape}; it must have 8 pixels or more each way")
    if along == "rows":
        on, off = _turned(on), _turned(off) if isinstance(off, np.ndarray) and off.ndim >= 2 else off
    height, width = on.shape[:2]
    try:
        first, end = (0, height) if band is None else map(int, band)
    except (TypeError, ValueError, OverflowError):
        first, end = 0, 0
    if not 0 <= first < end <= height or end - first < 8:
        raise InvalidInput(f"band is {band!r}, it must be (first, end) with 8 lines or more inside 0 ... {height}")
    reason = unusable_frame(on[first:end], None if off is None else off, on.shape)
    if reason:
        return bad_frame(width, reason)
    rows = Band(on[first:end], None if off is None else off[first:end], first)
    return METHODS[method](rows) if threshold is None else extract_paper(rows, threshold)


def _turned(picture: Image) -> Image:
    """Transpose an image; a valid image is copied to contiguous memory, which is faster to read."""
    turned = picture.swapaxes(0, 1)
    if picture.dtype not in (np.uint8, np.uint16) or picture.ndim > 3:
        return turned
    return np.asarray(cv2.transpose(picture)).reshape(turned.shape)
