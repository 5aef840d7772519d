"""The `precise` method: sub-pixel stripe centre per column with a sigma, or an honest reason why there is none."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from guara_perception.stripes.centre import centres, stripe_sigma
from guara_perception.stripes.choose import choose_peaks
from guara_perception.stripes.middle import middle, spread
from guara_perception.stripes.peaks import highest_peaks
from guara_perception.stripes.profile import StripeProfile, StripeStatus, bad_frame
from guara_perception.stripes.signal import SAMPLE_COLUMNS, SAMPLE_ROWS, LaserLight, Light, fused_light, laser_light
from guara_perception.stripes.smooth_line import smooth_line

Float32 = npt.NDArray[np.float32]
Index = npt.NDArray[np.intp]

# Averaging three columns before looking for the peak halves the noise of a dim stripe.
COLUMN_MEAN_PX = 3
# Factor that keeps fractions of a grey level when rows are smoothed in whole numbers: 255 * 3 * 8 fits 16 bits.
ROW_SCALE = 8
SCALE = COLUMN_MEAN_PX * ROW_SCALE
# Smoothing across the stripe before the peak is sought; a wide stripe is smoothed again to its own width.
ROW_SMOOTHING_SIGMA_PX = 1.0
WIDE_SIGMA_PX = 2.5
# Noise below a third of a quantum cannot be seen in whole grey levels.
LEAST_NOISE = 0.3
# 5 sigma lets 0.1 % false columns through; the relative floor keeps a faint halo out of the gaps of a bright stripe.
THRESHOLD_SIGMAS = 5.0
THRESHOLD_OF_MEDIAN_PEAK = 0.05
# The width of the stripe is taken from every so many columns.
WIDTH_COLUMNS = 16
# From this share of clipped tops on, the channels are fused.
FUSE_FROM_CLIPPED = 0.2
# A clipped core wider than so many sigmas of the stripe leaves no shoulders to judge by.
MAX_CLIPPED_SIGMAS = 5.0
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
    every = np.arange(columns)
    light = _sum_of_columns(signal.light)
    smooth = _smooth_rows(light, ROW_SMOOTHING_SIGMA_PX)
    peaks = highest_peaks(smooth)
    noise = _noise(smooth, LEAST_NOISE * SCALE)
    strong = peaks.height > THRESHOLD_SIGMAS * noise
    if _is_swapped(smooth, peaks.height, noise):
        return bad_frame(
            columns, "the stripe is darker than its surroundings: laser-on and laser-off frames are swapped"
        )
    is_clipped = signal.plane[peaks.top, every] >= signal.clipped_from
    has_colour = on.ndim == 3 and on.shape[2] == 3
    is_fused = (
        has_colour
        and strong.any()
        and np.count_nonzero(is_clipped & strong) / np.count_nonzero(strong) > FUSE_FROM_CLIPPED
    )
    if is_fused:
        light = _sum_of_columns(fused_light(on, off, peaks.top[strong], every[strong]))
        smooth = _smooth_rows(light, ROW_SMOOTHING_SIGMA_PX)
        peaks = highest_peaks(smooth)
        noise = _noise(smooth, LEAST_NOISE * SCALE)
        strong = peaks.height > THRESHOLD_SIGMAS * noise
    some = np.flatnonzero(strong)[::WIDTH_COLUMNS]
    sigma = round(stripe_sigma(light, peaks.top[some], some, peaks.height[some] / np.float32(ROW_SCALE)), 1)
    if sigma > WIDE_SIGMA_PX:
        smooth = _smooth_rows(light, sigma)
        peaks = highest_peaks(smooth)
        noise = _noise(smooth, LEAST_NOISE * SCALE)
        strong = peaks.height > THRESHOLD_SIGMAS * noise
    median_peak = middle(peaks.height[strong]) if strong.any() else 0.0
    threshold = max(THRESHOLD_SIGMAS * noise, THRESHOLD_OF_MEDIAN_PEAK * median_peak)
    choice = choose_peaks(smooth, peaks, threshold, sigma)
    row, per_grey_level = centres(light, choice.top, every, sigma_of_filter(sigma))
    is_peak = choice.height > threshold
    is_found = is_peak & np.isfinite(row)
    clipped, drowned = _clipped_rows(on if is_fused else signal.plane, signal, choice.top, sigma)
    is_cut = (choice.top < 2) | (choice.top > rows - 3)
    is_drowned = drowned > MAX_CLIPPED_SIGMAS * sigma
    status = np.full(columns, StripeStatus.DROPOUT, dtype=np.uint8)
    status[is_found] = StripeStatus.OK
    status[is_found & (clipped > 0)] = StripeStatus.SATURATED
    status[is_found & (choice.is_ambiguous | is_drowned)] = StripeStatus.AMBIGUOUS
    status[is_peak & ~is_found] = StripeStatus.AMBIGUOUS
    status[is_peak & is_cut] = StripeStatus.OUT_OF_BAND

    row, shrink = smooth_line(np.where(is_found, row, np.nan).astype(np.float32), choice.height)
    usable = (status == StripeStatus.OK) | (status == StripeStatus.SATURATED)
    variance = (_noise(light, LEAST_NOISE * COLUMN_MEAN_PX) * per_grey_level * shrink) ** 2 + (
        SPECKLE_OF_SIGMA * sigma
    ) ** 2 * shrink
    if off is not None:
        variance += _albedo_shift(off, signal.channel, choice.top, sigma) ** 2
    nan = np.float32(np.nan)
    position = (first_row + row).astype(np.float32)
    return StripeProfile(
        position_px=np.where(usable, position, nan),
        sigma_px=np.where(usable, np.sqrt(variance), nan).astype(np.float32),
        status=status,
        peak=choice.height / np.float32(SCALE),
        doubtful_px=np.where(is_found & ~usable, position, nan),
    )


def _clipped_rows(frame: npt.NDArray[Any], signal: LaserLight, top: Index, sigma: float) -> tuple[Index, Index]:
    """How many rows around the top are clipped: in the strongest channel, and in all channels of `frame`.

    With several channels the core is lost only where all of them are clipped.
    """
    nothing = np.zeros(top.size, dtype=np.intp)
    if signal.plane.max() < signal.clipped_from:
        return nothing, nothing
    reach = int(3 * sigma)
    rows = np.clip(top + np.arange(-reach, reach + 1)[:, None], 0, len(frame) - 1)
    every = np.arange(top.size)
    is_clipped = signal.plane[rows, every] >= signal.clipped_from
    strongest = is_clipped.sum(axis=0)
    if frame.ndim == 2:
        return strongest, strongest
    # Where the strongest channel is not clipped, not all of them are: only the rest needs a look.
    place, column = np.nonzero(is_clipped)
    is_lost = (frame[rows[place, column], column] >= signal.clipped_from).all(axis=1)
    return strongest, np.bincount(column[is_lost], minlength=top.size)


def sigma_of_filter(sigma: float) -> float:
    """Width of the filter that finds the centre of a stripe of this width [px].

    Speckle makes a thin stripe's own width too narrow a window; of a wide one, clipped or in a halo, the core is best.
    """
    return round(float(np.hypot(0.85 * sigma, 1.3)), 1)


def _is_swapped(smooth: Light, height: Float32, noise: float) -> bool:
    """Whether the dark side of the difference looks like a stripe and the bright side does not."""
    lowest = -smooth[:, ::WIDTH_COLUMNS].min(axis=0).astype(np.float32)
    return bool(lowest.max() > 2 * height.max() and middle(lowest) > 2 * THRESHOLD_SIGMAS * noise)


def _sum_of_columns(light: Light) -> Light:
    """Sums of COLUMN_MEAN_PX columns: a mean in whole numbers would lose what the noise is judged by."""
    return cv2.boxFilter(light, -1, (COLUMN_MEAN_PX, 1), normalize=False)  # type: ignore[return-value]


def _smooth_rows(light: Light, sigma: float) -> Light:
    """Gaussian smoothing along the columns, times ROW_SCALE."""
    taps = ROW_SCALE * cv2.getGaussianKernel(2 * int(np.ceil(2 * sigma)) + 1, sigma)
    one = np.ones(1)
    return cv2.sepFilter2D(light, -1, one, taps, borderType=cv2.BORDER_REPLICATE)  # type: ignore[return-value]


def _noise(light: Light, least: float) -> float:
    sample = light[::SAMPLE_ROWS, ::SAMPLE_COLUMNS]
    return max(spread(sample), least)


def _albedo_shift(off: npt.NDArray[Any], channel: int, top: Index, sigma: float) -> Float32:
    """How far the brightness gradient of the surface may have pulled the centre, per column [px].

    Reflectance that changes by a factor exp(g) per row shifts a Gaussian stripe by g sigma^2 rows. The laser-off
    picture shows the reflectance under ambient light, noise included, hence only a share of it.
    """
    step = max(int(round(ALBEDO_SIGMAS * sigma)), 2)
    every = np.arange(off.shape[1])
    plane = off if off.ndim == 2 else off[:, :, channel]
    above = plane[np.clip(top - step, 0, len(plane) - 1), every].astype(np.float32)
    below = plane[np.clip(top + step, 0, len(plane) - 1), every].astype(np.float32)
    gradient = (below - above) / (np.maximum(above + below, 1.0) * step)
    return np.asarray(ALBEDO_SHARE * gradient * sigma**2, dtype=np.float32)
