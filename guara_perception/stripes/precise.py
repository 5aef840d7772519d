"""The `precise` method: sub-pixel stripe centre per column with a sigma, or an honest reason why there is none."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from guara_perception.stripes.centre import centres
from guara_perception.stripes.choose import choose_peaks
from guara_perception.stripes.clipped import clipped_columns
from guara_perception.stripes.filters import ROW_SMOOTHING_SIGMA_PX, ROW_TAPS, SCALE
from guara_perception.stripes.find_peaks import find_peaks
from guara_perception.stripes.profile import StripeProfile, StripeStatus, bad_frame, nothing
from guara_perception.stripes.signal import laser_light
from guara_perception.stripes.smooth_line import smooth_line
from guara_perception.stripes.windows import at_rows

Float32 = npt.NDArray[np.float32]
Index = npt.NDArray[np.intp]

# Speckle moves the centre of a stripe by this share of its sigma, whatever the light.
SPECKLE_OF_SIGMA = 0.06
# A surface that is brighter on one side of the stripe pulls its centre over: share of the first-order shift.
ALBEDO_SHARE = 0.5
ALBEDO_SIGMAS = 1.5


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
    found = find_peaks(signal.light)
    sigma = found.sigma
    choice = choose_peaks(found.sought, found.peaks, found.threshold, sigma)
    is_peak = choice.height > found.threshold
    peaks = np.flatnonzero(is_peak)
    row, per_grey_level = np.full((2, columns), np.nan, np.float32)
    row[peaks], per_grey_level[peaks] = centres(
        found.smooth, choice.top[peaks], peaks, sigma_of_filter(sigma), ROW_TAPS
    )
    is_found = np.isfinite(row)
    is_core_clipped = is_core_lost = np.zeros(columns, dtype=bool)
    if signal.is_clipped:
        is_core_clipped, is_core_lost = clipped_columns(
            signal.frame, choice.top, sigma, signal.channel, is_fused=signal.is_fused
        )
    is_cut = (choice.top < 2) | (choice.top > rows - 3)
    status = np.full(columns, StripeStatus.DROPOUT, dtype=np.uint8)
    status[is_found] = StripeStatus.OK
    status[is_found & is_core_clipped] = StripeStatus.SATURATED
    status[is_found & (choice.is_ambiguous | is_core_lost)] = StripeStatus.AMBIGUOUS
    status[is_peak & ~is_found] = StripeStatus.AMBIGUOUS
    status[is_peak & is_cut] = StripeStatus.OUT_OF_BAND

    row, shrink = smooth_line(row, choice.height)
    usable = (status == StripeStatus.OK) | (status == StripeStatus.SATURATED)
    variance = (found.noise * per_grey_level * shrink) ** 2 + (SPECKLE_OF_SIGMA * sigma) ** 2 * shrink
    if signal.background is not None:
        variance += _albedo_shift(signal.background, signal.channel, choice.top, sigma) ** 2
    is_doubtful = is_found & ~usable
    nan = np.float32(np.nan)
    position = row + np.float32(first_row)
    return StripeProfile(
        position_px=np.where(usable, position, nan),
        sigma_px=np.where(usable, np.sqrt(variance), nan),
        status=status,
        peak=choice.height / np.float32(SCALE),
        doubtful_px=np.where(is_doubtful, position, nan) if is_doubtful.any() else nothing(columns),
    )


def sigma_of_filter(sigma: float) -> float:
    """Width of the filter that finds the centre of a stripe of this width in smoothed light [px].

    Speckle makes a thin stripe's own width too narrow a window; of a wide one, clipped or in a halo, the core is best.
    What the light was smoothed by already counts as part of it.
    """
    return round(float(np.sqrt((0.85 * sigma) ** 2 + 1.3**2 - ROW_SMOOTHING_SIGMA_PX**2)), 1)


def _albedo_shift(off: npt.NDArray[Any], channel: int, top: Index, sigma: float) -> Float32:
    """How far the brightness gradient of the surface may have pulled the centre, per column [px].

    Reflectance that changes by a factor exp(g) per row shifts a Gaussian stripe by g sigma^2 rows. The laser-off
    picture shows the reflectance under ambient light, noise included, hence only a share of it.
    """
    step = max(int(round(ALBEDO_SIGMAS * sigma)), 2)
    every = np.arange(top.size)
    above, below = (at_rows(off, rows, every, channel).astype(np.float32) for rows in (top - step, top + step))
    slope = np.float32(ALBEDO_SHARE * sigma**2 / step)
    return np.asarray(slope * (below - above) / np.maximum(above + below, np.float32(1)))
