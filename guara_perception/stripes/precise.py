"""The `precise` method: sub-pixel stripe centre per column with a sigma, or an honest reason why there is none."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from guara_perception.stripes.profile import StripeProfile, StripeStatus, bad_frame
from guara_perception.stripes.signal import laser_light
from guara_perception.stripes.smooth_line import smooth_line

Float32 = npt.NDArray[np.float32]

# Averaging three columns before looking for the peak halves the noise of a dim stripe.
COLUMN_MEAN_PX = 3
ROW_SMOOTHING_SIGMA_PX = 1.0
ROW_SMOOTHING_SIZE_PX = 5
# 5 sigma lets 0.1 % false columns through; the relative floor keeps a faint halo out of the gaps of a bright stripe.
THRESHOLD_SIGMAS = 5.0
THRESHOLD_OF_MEDIAN_PEAK = 0.05
# Centre of gravity over +-3 rows, above 5 % of the peak: the least error of the widths and floors tried.
CENTRE_HALF_WINDOW_PX = 3
CENTRE_FLOOR = 0.05
# A second peak this strong, further off than a stripe is wide, makes the column ambiguous.
RIVAL_OF_PEAK = 0.5
RIVAL_DISTANCE_PX = 8
# A clipped core wider than this hides its shoulders from the centre window.
MAX_CLIPPED_RUN_PX = 5
# Speckle and model error that no averaging removes.
SIGMA_FLOOR_PX = 0.03


def extract_precise(on: npt.NDArray[Any], off: npt.NDArray[Any] | None, first_row: int = 0) -> StripeProfile:
    """Find one stripe that runs across the columns of a band.

    Args:
        on: (rows, columns[, 3]) uint8 or uint16, the band with the laser on.
        off: the same rows with the laser off, or None.
        first_row: row of the band's first line in the full picture.

    Returns:
        One position per column in full-picture rows.
    """
    rows, columns = on.shape[:2]
    signal = laser_light(on, off)
    if signal.reason:
        return bad_frame(columns, signal.reason)
    mean = cv2.blur(signal.light, (COLUMN_MEAN_PX, 1))
    size = (1, min(ROW_SMOOTHING_SIZE_PX, rows - 1 + rows % 2))
    smooth: Float32 = np.asarray(
        cv2.GaussianBlur(mean, size, ROW_SMOOTHING_SIGMA_PX, borderType=cv2.BORDER_REPLICATE), dtype=np.float32
    )
    sample = smooth[::2, ::3]
    noise = max(1.4826 * float(np.median(np.abs(sample - np.median(sample)))), 1e-3)
    if -smooth.min() > 2 * smooth.max() and -np.median(smooth.min(axis=0)) > 2 * THRESHOLD_SIGMAS * noise:
        return bad_frame(
            columns, "the stripe is darker than its surroundings: laser-on and laser-off frames are swapped"
        )

    every = np.arange(columns)
    top = smooth.argmax(axis=0)
    peak = smooth[top, every]
    strong = peak > THRESHOLD_SIGMAS * noise
    median_peak = float(np.median(peak[strong])) if strong.any() else 0.0
    is_found = strong & (peak > THRESHOLD_OF_MEDIAN_PEAK * median_peak)

    offsets = np.arange(-CENTRE_HALF_WINDOW_PX, CENTRE_HALF_WINDOW_PX + 1)
    window_rows = np.clip(top + offsets[:, None], 0, rows - 1)
    window = np.maximum(smooth[window_rows, every] - CENTRE_FLOOR * peak, 0)
    weight = window.sum(axis=0)
    shift = (window * offsets[:, None]).sum(axis=0) / np.maximum(weight, 1e-9)
    position = (first_row + top + shift).astype(np.float32)

    status = np.where(is_found, StripeStatus.OK, StripeStatus.DROPOUT).astype(np.uint8)
    # Centre of gravity: variance = noise^2 sum(offset^2) / weight^2; smoothing correlates neighbours, hence the factor.
    spread = np.sqrt(float((offsets**2).sum()))
    sigma = np.sqrt((1.5 * noise * spread / np.maximum(weight, 1e-9)) ** 2 + SIGMA_FLOOR_PX**2)

    is_cut = (top < 2) | (top > rows - 3)
    status[is_found & is_cut] = StripeStatus.OUT_OF_BAND
    clipped = signal.is_clipped[window_rows, every].sum(axis=0)
    status[is_found & ~is_cut & (clipped > 0)] = StripeStatus.SATURATED
    sigma = np.where(clipped > 0, 1.5 * sigma, sigma)
    is_rivalled = is_found & (_second_peak(smooth, top) > RIVAL_OF_PEAK * peak)
    is_drowned = is_found & (clipped > MAX_CLIPPED_RUN_PX)
    status[(is_rivalled | is_drowned) & ~is_cut] = StripeStatus.AMBIGUOUS

    smoothed, shrink = smooth_line(np.where(is_found, position, np.nan).astype(np.float32), peak**2)
    position = np.where(is_found, smoothed, position)
    usable = (status == StripeStatus.OK) | (status == StripeStatus.SATURATED)
    nan = np.float32(np.nan)
    return StripeProfile(
        position_px=np.where(usable, position, nan),
        sigma_px=np.where(usable, sigma, nan).astype(np.float32),
        status=status,
        peak=peak.astype(np.float32),
        doubtful_px=np.where(is_found & ~usable, position, nan),
    )


def _second_peak(smooth: Float32, top: npt.NDArray[np.intp]) -> Float32:
    """Height of the highest peak further than RIVAL_DISTANCE_PX from the first, per column."""
    rows = np.arange(smooth.shape[0])[:, None]
    far = np.abs(rows - top) > RIVAL_DISTANCE_PX
    return np.asarray(np.where(far, smooth, -np.inf).max(axis=0), dtype=np.float32)
