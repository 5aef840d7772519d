"""The `paper` method: red-enhanced grey, background removed, binarised, skeletonised, mean row per column."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from guara_perception.stripes.band import Band
from guara_perception.stripes.middle import middle
from guara_perception.stripes.profile import StripeProfile, StripeStatus, bad_frame
from guara_perception.stripes.signal import MAX_AMBIENT_CHANGE, opening
from guara_perception.stripes.thinning import skeleton

Grey = npt.NDArray[np.uint8]

# Red-enhanced grey of a BGR picture: the paper names no numbers; red carries the laser, the rest steadies the grey.
BLUE_SHARE, GREEN_SHARE, RED_SHARE = 0.05, 0.15, 0.80
# Otsu's threshold splits the noise where there is no stripe: below so many sigmas of it nothing counts.
THRESHOLD_SIGMAS = 5.0
UPPER_QUARTILE = 0.674
# A skeleton is right to about half a pixel.
SIGMA_PX = 0.5
# Skeleton pixels of one column that spread over more rows belong to two lines.
MOST_SPREAD_PX = 4


def extract_paper(bands: Sequence[Band]) -> list[StripeProfile]:
    """Find the stripes of some bands as the paper does; for each band one position per column in full-picture rows."""
    return [paper_stripe(band) for band in bands]


def paper_stripe(band: Band, threshold: float | None = None) -> StripeProfile:
    """Find one stripe as the paper does.

    Args:
        band: rows to look in.
        threshold: fixed threshold of the binarisation [grey levels of 8 bits]; None = Otsu's.

    Returns:
        One position per column in full-picture rows.
    """
    rows, columns = band.on.shape[:2]
    grey = red_enhanced_grey(band.on)
    background = opening(grey) if band.off is None else red_enhanced_grey(band.off.frame)
    change = middle(grey[::8, ::24].astype(np.int16) - background[::8, ::24])
    if abs(change) > MAX_AMBIENT_CHANGE * 255:
        return bad_frame(
            columns, f"brightness beside the stripe changed by {change:+.0f} of 255 between laser off and on"
        )
    light = remove_background(grey, background)
    thin = skeleton(binarise(light, threshold))
    row, extent = mean_rows(thin)
    peak = light.max(axis=0).astype(np.float32)
    found = np.isfinite(row)
    status = np.where(found, StripeStatus.OK, StripeStatus.DROPOUT).astype(np.uint8)
    status[found & (extent > MOST_SPREAD_PX)] = StripeStatus.AMBIGUOUS
    with np.errstate(invalid="ignore"):
        status[found & ((row < 2) | (row > rows - 3))] = StripeStatus.OUT_OF_BAND
    usable = status == StripeStatus.OK
    position = (band.first_row + row).astype(np.float32)
    nan = np.float32(np.nan)
    return StripeProfile(
        position_px=np.where(usable, position, nan),
        sigma_px=np.where(usable, np.float32(SIGMA_PX), nan),
        status=status,
        peak=peak,
        doubtful_px=np.where(found & ~usable, position, nan),
    )


def red_enhanced_grey(frame: npt.NDArray[Any]) -> Grey:
    """Grey picture of 8 bits in which red counts most; a mono picture is taken as it is."""
    if frame.dtype == np.uint16:
        frame = (frame >> 8).astype(np.uint8)
    if frame.ndim == 2:
        return np.ascontiguousarray(frame)
    if frame.shape[2] == 1:
        return np.ascontiguousarray(frame[:, :, 0])
    shares = np.array([[BLUE_SHARE, GREEN_SHARE, RED_SHARE]], dtype=np.float32)
    return np.asarray(cv2.transform(frame, shares), dtype=np.uint8).reshape(frame.shape[:2])


def remove_background(grey: Grey, background: Grey) -> Grey:
    """Laser light alone; negative differences become zero."""
    return np.asarray(cv2.subtract(grey, background), dtype=np.uint8)


def binarise(light: Grey, threshold: float | None = None) -> npt.NDArray[np.bool_]:
    """Where the light exceeds a fixed threshold, or Otsu's but never the noise.

    Args:
        light: (rows, columns) laser light.
        threshold: fixed threshold; None = Otsu's.
    """
    if threshold is None:
        otsu, _ = cv2.threshold(light, 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
        # Half of the noise was cut off at zero, but its upper quartile is where it was: at 0.674 sigma.
        noise = float(np.percentile(light[::3, ::16], 75)) / UPPER_QUARTILE
        threshold = max(otsu, THRESHOLD_SIGMAS * max(noise, 0.5))
    return np.asarray(light > threshold)


def mean_rows(thin: npt.NDArray[np.bool_]) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.int64]]:
    """Mean row (columns,) of the pixels of each column, NaN where there are none, and how far apart they lie."""
    count = thin.sum(axis=0)
    rows = np.arange(len(thin))[:, None]
    mean = np.where(count > 0, (thin * rows).sum(axis=0) / np.maximum(count, 1), np.nan)
    first = thin.argmax(axis=0)
    last = len(thin) - 1 - thin[::-1].argmax(axis=0)
    return mean, np.where(count > 0, last - first, 0)
