"""Finds the peaks of a band of laser light: how high they must be to count, and how wide the stripe is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from guara_perception.stripes.centre import stripe_sigma
from guara_perception.stripes.filters import (
    COLUMN_MEAN_PX,
    ROW_SMOOTHING_SIGMA_PX,
    SCALE,
    smooth_light,
    smooth_wide,
    sums_of_columns,
)
from guara_perception.stripes.middle import middle, spread
from guara_perception.stripes.peaks import Peaks, highest_peaks
from guara_perception.stripes.windows import SAMPLE_COLUMNS, SAMPLE_ROWS, sampled

Light = npt.NDArray[Any]
Index = npt.NDArray[np.intp]

# A stripe wider than this is smoothed again to its own width.
WIDE_SIGMA_PX = 2.5
# Noise below a third of a quantum cannot be seen in whole grey levels.
LEAST_NOISE = 0.3
# 5 sigma lets 0.1 % false columns through; the relative floor keeps a faint halo out of the gaps of a bright stripe.
THRESHOLD_SIGMAS = 5.0
THRESHOLD_OF_MEDIAN_PEAK = 0.05
# The width of the stripe is taken from every so many columns.
WIDTH_COLUMNS = 32


@dataclass(frozen=True, slots=True)
class FoundPeaks:
    """The highest peaks of a band.

    Attributes:
        smooth: (rows, columns) laser light after `smooth_light`.
        sought: (rows, columns) what the peaks were sought in: `smooth`, or for a wide stripe smoother still.
        peaks: the highest peak per column of `sought`.
        threshold: least height of a peak that counts, in units of `sought`.
        noise: standard deviation of sums of COLUMN_MEAN_PX columns of laser light.
        sigma: width of the stripe [px].
    """

    smooth: Light
    sought: Light
    peaks: Peaks
    threshold: float
    noise: float
    sigma: float


def find_peaks(light: Light) -> FoundPeaks:
    """Find the highest peak per column.

    Args:
        light: (rows, columns) int16 or float32 laser light [grey levels].
    """
    smooth = sought = smooth_light(light)
    peaks, noise, columns = _strong(sought)
    some = columns[::WIDTH_COLUMNS]
    sigma = round(stripe_sigma(smooth, peaks.top[some], some, peaks.height[some], ROW_SMOOTHING_SIGMA_PX), 1)
    if sigma > WIDE_SIGMA_PX:
        sought = smooth_wide(light, sigma)
        peaks, noise, columns = _strong(sought)
    median_peak = middle(peaks.height[columns]) if columns.size else 0.0
    threshold = max(THRESHOLD_SIGMAS * noise, THRESHOLD_OF_MEDIAN_PEAK * median_peak)
    own_noise = max(spread(sums_of_columns(light, SAMPLE_ROWS, SAMPLE_COLUMNS)), LEAST_NOISE * COLUMN_MEAN_PX)
    return FoundPeaks(smooth, sought, peaks, threshold, own_noise, sigma)


def _strong(sought: Light) -> tuple[Peaks, float, Index]:
    """Highest peaks, standard deviation of the noise, and the columns whose peak stands out from it."""
    peaks = highest_peaks(sought)
    noise = max(spread(sampled(sought)), LEAST_NOISE * SCALE)
    return peaks, noise, np.flatnonzero(peaks.height > THRESHOLD_SIGMAS * noise)
