"""`extract_stripe`: the stripe of one picture by a chosen method; checks of pictures."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import cv2
import numpy as np

from guara_perception.arrays import Float, Image, Index
from guara_perception.exceptions import InvalidInput
from guara_perception.stripes.band import Band, StripeProfile, bad_frame
from guara_perception.stripes.laser_light import is_clipped
from guara_perception.stripes.paper import extract_paper
from guara_perception.stripes.precise import extract_precise

# Whether a band is white is checked in every eighth row, and in 40 to 79 columns of a wide picture.
CHECKED_ROWS, CHECKED_COLUMNS = 8, 40
Extract = Callable[[Sequence[Band]], list[StripeProfile]]
METHODS: dict[str, Extract] = {"precise": extract_precise, "paper": extract_paper}
# Light counts when it stands this far above what is usual in its column.
LEAST_LEVEL = 12.0
LEAST_SIGMAS = 8.0
ROWS_APART = 2
# What is usual in a column shows in every eighth of those rows.
USUAL_ROWS_APART = 8
# Columns of a grey picture differ from their neighbours by a thousandth, those behind a colour filter by 2 %
# under white light at the least, and by 30 to 95 % of its light in a red laser's.
LEAST_AMBIENT_CONTRAST = 0.012
LEAST_LASER_CONTRAST = 0.25
LEAST_LASER_LEVEL = 0.15
QUARTERS = 4


def extract_stripe(
    on: Image,
    off: Image | None = None,
    along: str = "columns",
    band: tuple[int, int] | None = None,
    method: str = "precise",
) -> StripeProfile:
    """Find the laser stripe in one picture.

    Args:
        on: (h, w) or (h, w, 3) BGR as OpenCV reads it, uint8 or uint16, laser on.
        off: the same view with the laser off; None = the background is estimated from `on`.
        along: "columns": the stripe crosses the columns, one position (a row) per column; "rows": one position
            (a column) per row.
        band: (first, end) rows that are searched, or columns for along="rows"; None = the whole picture.
        method: one of METHODS.

    Returns:
        A StripeProfile with w entries (h for along="rows"). A picture that cannot be used (blank, white,
        another size or type than its off frame) gives FRAME_BAD in every entry and says why.

    Raises:
        InvalidInput: `on` is no picture of 8 by 8 pixels or more, or an argument is not one of those allowed.
    """
    if method not in METHODS:
        raise InvalidInput(f"method is {method!r}, allowed: {', '.join(METHODS)}")
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
    return METHODS[method]([Band.of(on[first:end], None if off is None else off[first:end], first)])[0]


def unusable_frame(band: Image, off: Image | None, shape: tuple[int, ...]) -> str:
    """Reason for which a frame cannot be used; empty for a usable one.

    Args:
        band: the rows of the laser-on frame that will be searched.
        off: the whole laser-off frame, or None.
        shape: shape of the whole laser-on frame.
    """
    if off is not None:
        if not isinstance(off, np.ndarray) or off.dtype != band.dtype or off.shape != shape:
            given = f"{off.dtype} {off.shape}" if isinstance(off, np.ndarray) else type(off).__name__
            return f"laser-off frame is {given}, laser-on frame is {band.dtype} {shape}: they must be alike"
    sampled = np.ascontiguousarray(band[::CHECKED_ROWS, :: max(band.shape[1] // CHECKED_COLUMNS, 1)])
    low, high = float(sampled.min()), float(sampled.max())
    if low == high and float(band.min()) == float(band.max()):
        return f"the frame is blank: every pixel is {low:.0f}"
    if np.count_nonzero(is_clipped(sampled)) > 0.5 * sampled.size:
        return "more than half of the frame is white: exposure too long or too much light"
    return ""


def _turned(picture: Image) -> Image:
    """The picture with its rows as columns; a valid one in contiguous memory, which is quicker to read."""
    turned = picture.swapaxes(0, 1)
    if picture.dtype not in (np.uint8, np.uint16) or picture.ndim > 3:
        return turned
    return np.asarray(cv2.transpose(picture)).reshape(turned.shape)


def picture_fault(on: Image) -> str:
    """Text that says what was given in place of a camera's picture; empty for a picture."""
    if not isinstance(on, np.ndarray):
        return f"{type(on).__name__}, it must be a numpy array"
    if on.dtype not in (np.uint8, np.uint16) or on.ndim not in (2, 3) or (on.ndim == 3 and on.shape[2] not in (1, 3)):
        return f"{on.dtype} {on.shape}, it must be uint8 or uint16, (h, w) or (h, w, 3)"
    return ""


def brightest_rows(on: Image, off: Image | None, columns: Index) -> Float:
    """Row of the brightest light in some columns (n,) of a whole frame [px]; NaN where none stands out.

    Args:
        on: (h, w) or (h, w, 3), laser on.
        off: the same with the laser off, or None.
        columns: (n,) columns to look at.
    """
    seen = on[::ROWS_APART, columns].astype(np.float32)
    if off is not None and off.shape == on.shape:
        seen -= off[::ROWS_APART, columns]
    if seen.ndim == 3:
        seen = seen.max(axis=2)
    if on.dtype == np.uint16:
        seen /= 257.0
    some = seen[::USUAL_ROWS_APART]
    usual = np.median(some, axis=0)
    noise = np.median(np.abs(some - usual), axis=0)
    row = seen.argmax(axis=0)
    height = seen[row, np.arange(len(columns))] - usual
    return np.where(height > np.maximum(LEAST_LEVEL, LEAST_SIGMAS * noise), ROWS_APART * row, np.nan)


def is_raw_bayer(on: Image, off: Image | None) -> bool:
    """Detect the 2 x 2 pattern of a colour filter in a picture of one channel, or in its rows from an even one on.

    Grey pictures have no reason to differ between even and odd columns all over; behind a colour filter these differ,
    in even rows otherwise than in odd ones.
    """
    if on.ndim == 3 and on.shape[2] != 1:
        return False
    if off is None or off.shape != on.shape:
        return _agree(_of_sums(_sums(on)), LEAST_AMBIENT_CONTRAST)
    dark = _sums(off)
    light = _sums(on) - dark
    # Rows of one kind hardly take in the laser: each kind is judged by itself, and only where there is more than noise.
    apart = np.abs(light[..., 0] - light[..., 1]) / (on.shape[0] / 2 * on.shape[1] / QUARTERS)
    laser = np.where(apart > LEAST_LASER_LEVEL, _of_sums(light), 0.0)
    return _agree(laser, LEAST_LASER_CONTRAST) or _agree(_of_sums(dark), LEAST_AMBIENT_CONTRAST)


def _sums(picture: Image) -> Float:
    """(2 kinds of row, QUARTERS of the width, 2 kinds of column) sums of levels."""
    height, width = picture.shape[0] // 2 * 2, picture.shape[1] // (2 * QUARTERS) * 2 * QUARTERS
    plane = picture.reshape(picture.shape[:2])[:height, :width]
    by_column = np.array([plane[row::2].sum(axis=0, dtype=np.float64) for row in (0, 1)])
    return by_column.reshape(2, QUARTERS, -1, 2).sum(axis=2)


def _of_sums(sums: Float) -> Float:
    """(2, QUARTERS) difference over sum of even and odd columns."""
    return np.asarray((sums[..., 0] - sums[..., 1]) / np.maximum(np.abs(sums).sum(axis=-1), 1e-9))


def _agree(contrast: Float, least: float) -> bool:
    """Test that one kind of row differs by more than `least`, with one sign, in all quarters but one at the most."""
    more, less = (contrast > least).sum(axis=1), (contrast < -least).sum(axis=1)
    return bool((np.maximum(more, less) >= QUARTERS - 1).any())
