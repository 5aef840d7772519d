"""Finds the peaks of a band of laser light: how high they must be to count, and how wide the stripe is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from guara_perception.stripes.centre import stripe_sigma
from guara_perception.stripes.filters import (
    COLUMN_MEAN_PX,
    MARGIN,
    ROW_SCALE,
    SCALE,
    smooth_rows,
    smooth_wide,
    sum_of_columns,
)
from guara_perception.stripes.middle import middle, spread
from guara_perception.stripes.peaks import Peaks, highest_peaks

Light = npt.NDArray[Any]
Index = npt.NDArray[np.intp]

# A stripe wider than this is smoothed again to its own width.
WIDE_SIGMA_PX = 2.5
# Noise below a third of a quantum cannot be seen in whole grey levels.
LEAST_NOISE = 0.3
# 5 sigma lets 0.1 % false columns through; the relative floor keeps a faint halo out of the gaps of a bright stripe.
THRESHOLD_SIGMAS = 5.0
THRESHOLD_OF_MEDIAN_PEAK = 0.05
# Statistics of a band are taken from every so many rows and columns.
SAMPLE_ROWS, SAMPLE_COLUMNS = 8, 24
# The width of the stripe is taken from every so many columns.
WIDTH_COLUMNS = 16


@dataclass(frozen=True, slots=True)
class FoundPeaks:
    """The highest peaks of a band.

    Attributes:
        light: (rows, columns) sums of COLUMN_MEAN_PX columns of laser light.
        smooth: (rows, columns) the same smoothed over rows, SCALE times a grey level.
        peaks: the highest peak per column of `smooth`.
        columns: (n,) columns whose peak stands out from the noise.
        threshold: least height of a peak that counts, in units of `smooth`.
        noise: standard deviation of `light` [grey levels times COLUMN_MEAN_PX].
        sigma: width of the stripe [px].
        is_swapped: whether the dark side looks like a stripe and the bright side does not.
    """

    light: Light
    smooth: Light
    peaks: Peaks
    columns: Index
    threshold: float
    noise: float
    sigma: float
    is_swapped: bool


def find_peaks(light: Light) -> FoundPeaks:
    """Find the highest peak per column.

    Args:
        light: (rows, columns) int16 or float32 laser light [grey levels].
    """
    padded = sum_of_columns(light)
    light, smooth = padded[MARGIN:-MARGIN], smooth_rows(padded)
    peaks, noise, columns = _strong(smooth)
    is_swapped = _is_swapped(smooth, peaks, noise)
    some = columns[::WIDTH_COLUMNS]
    sigma = round(stripe_sigma(light, peaks.top[some], some, peaks.height[some] / np.float32(ROW_SCALE)), 1)
    if sigma > WIDE_SIGMA_PX:
        smooth = smooth_wide(light, sigma)
        peaks, noise, columns = _strong(smooth)
    median_peak = middle(peaks.height[columns]) if columns.size else 0.0
    threshold = max(THRESHOLD_SIGMAS * noise, THRESHOLD_OF_MEDIAN_PEAK * median_peak)
    return FoundPeaks(
        light, smooth, peaks, columns, threshold, _noise(light, LEAST_NOISE * COLUMN_MEAN_PX), sigma, is_swapped
    )


def _strong(smooth: Light) -> tuple[Peaks, float, Index]:
    peaks = highest_peaks(smooth)
    noise = _noise(smooth, LEAST_NOISE * SCALE)
    return peaks, noise, np.flatnonzero(peaks.height > THRESHOLD_SIGMAS * noise)


def _is_swapped(smooth: Light, peaks: Peaks, noise: float) -> bool:
    lowest = -smooth[:, ::WIDTH_COLUMNS].min(axis=0).astype(np.float32)
    return bool(lowest.max() > 2 * peaks.height.max() and middle(lowest) > 2 * THRESHOLD_SIGMAS * noise)


def _noise(light: Light, least: float) -> float:
    return max(spread(light[::SAMPLE_ROWS, ::SAMPLE_COLUMNS]), least)
