"""Finds the peaks of a band of laser light: how high they must be to count, and how wide the stripe is."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from guara_perception.arrays import Array, Float32, Index
from guara_perception.stripes.band import SAMPLE_COLUMNS, SAMPLE_ROWS, rows_from, sampled
from guara_perception.stripes.centre import stripe_sigma
from guara_perception.stripes.median import robust_sigma, upper_median

# Averaging three columns before looking for the peak halves the noise of a dim stripe.
COLUMN_MEAN_PX = 3
# Three rows lose next to nothing of a thin stripe's peak; a wide stripe is smoothed to its own width.
ROW_MEAN_PX = 3
# Sigma of that mean [px].
ROW_SMOOTHING_SIGMA_PX = float(np.sqrt(2 / 3))
# Sums instead of means keep the fractions of a grey level in whole numbers.
SCALE = COLUMN_MEAN_PX * ROW_MEAN_PX
# A stripe wider than this is smoothed again to its own width.
WIDE_SIGMA_PX = 2.5
# Noise below a third of a quantum cannot be seen in whole grey levels.
LEAST_NOISE = 0.3
# 5 sigma lets 0.1 % false columns through; the relative floor keeps a faint halo out of the gaps of a bright stripe.
THRESHOLD_SIGMAS = 5.0
THRESHOLD_OF_MEDIAN_PEAK = 0.05
# Distance of the columns in which the stripe's width is measured.
WIDTH_COLUMNS = 32
# Maxima of blocks of rows are quick to take; the argmax is then taken within one block only.
BLOCK_ROWS = 8
MAX_CANDIDATES = 4


@dataclass(frozen=True, slots=True)
class Peaks:
    """The highest peak per column.

    Attributes:
        top: (columns,) row.
        height: (columns,) float32 value there.
        second: (columns,) float32 highest value at least one block away from the peak's block; 0 or less where none.
    """

    top: Index
    height: Float32
    second: Float32


@dataclass(frozen=True, slots=True)
class FoundPeaks:
    """The highest peaks of a band.

    Attributes:
        smooth: (rows, columns) laser light after `smooth_light`.
        searched: (rows, columns) the light that was searched for peaks: `smooth`, for a wide stripe smoother still.
        peaks: the highest peak per column of `searched`.
        threshold: least height of a peak that counts, in units of `searched`.
        noise: standard deviation of sums of COLUMN_MEAN_PX columns of laser light.
        sigma: width of the stripe [px].
    """

    smooth: Array
    searched: Array
    peaks: Peaks
    threshold: float
    noise: float
    sigma: float


def find_peaks(light: Array) -> FoundPeaks:
    """Find the highest peak per column.

    Args:
        light: (rows, columns) int16 or float32 laser light [grey levels].
    """
    smooth = searched = smooth_light(light)
    peaks, noise, columns = _strong(searched)
    some = columns[::WIDTH_COLUMNS]
    sigma = round(stripe_sigma(smooth, peaks.top[some], some, peaks.height[some], ROW_SMOOTHING_SIGMA_PX), 1)
    if sigma > WIDE_SIGMA_PX:
        searched = smooth_wide(light, sigma)
        peaks, noise, columns = _strong(searched)
    median_peak = upper_median(peaks.height[columns]) if columns.size else 0.0
    threshold = max(THRESHOLD_SIGMAS * noise, THRESHOLD_OF_MEDIAN_PEAK * median_peak)
    return FoundPeaks(smooth, searched, peaks, threshold, noise_of_columns(light), sigma)


def _strong(searched: Array) -> tuple[Peaks, float, Index]:
    """Highest peaks, standard deviation of the noise, and the columns whose peak stands out from it."""
    peaks = highest_peaks(searched)
    noise = max(robust_sigma(sampled(searched)), LEAST_NOISE * SCALE)
    return peaks, noise, np.flatnonzero(peaks.height > THRESHOLD_SIGMAS * noise)


def highest_peaks(smooth: Array) -> Peaks:
    """Highest value per column of a band (rows, columns)."""
    blocks = _block_maxima(smooth)
    best = _row_of_maximum(blocks)
    first = best * BLOCK_ROWS
    window = rows_from(smooth, first, BLOCK_ROWS, np.arange(smooth.shape[1]))
    height = window.max(axis=0).astype(np.float32)
    apart = np.abs(np.arange(len(blocks), dtype=np.int16)[:, None] - best.astype(np.int16)) > 1
    second = (blocks * apart).max(axis=0).astype(np.float32)
    return Peaks(first + _row_of_maximum(window), height, np.minimum(second, height))


def _block_maxima(smooth: Array) -> Array:
    """Maxima (blocks, columns) of every BLOCK_ROWS rows; the last block may be shorter."""
    whole = smooth.shape[0] // BLOCK_ROWS * BLOCK_ROWS
    blocks = smooth[:whole].reshape(-1, BLOCK_ROWS, smooth.shape[1]).max(axis=1)
    if whole == smooth.shape[0]:
        return np.asarray(blocks)
    return np.concatenate((blocks, smooth[whole:].max(axis=0, keepdims=True)))


def _row_of_maximum(values: Array) -> Index:
    """First row of the highest value per column; numpy's argmax along the columns takes twice as long."""
    count = np.arange(len(values), 0, -1, dtype=np.int16)[:, None]
    return np.asarray(len(values) - (count * (values == values.max(axis=0))).max(axis=0), dtype=np.intp)


def candidates(smooth: Array, columns: Index, threshold: float, distance: int) -> tuple[Index, Float32]:
    """Up to MAX_CANDIDATES local maxima of some columns, highest first.

    Args:
        smooth: (rows, all columns) smoothed light.
        columns: (n,) columns that are searched.
        threshold: least height of a candidate.
        distance: candidates of one column are further apart than this [px].

    Returns:
        Rows (MAX_CANDIDATES, n) and heights (MAX_CANDIDATES, n); height 0 where a column has fewer.
    """
    light = smooth[:, columns].astype(np.float32)
    peak = light.copy()
    peak[1:][light[1:] < light[:-1]] = 0
    peak[:-1][light[:-1] < light[1:]] = 0
    peak[peak < threshold] = 0
    every = np.arange(columns.size)
    rows = np.zeros((MAX_CANDIDATES, columns.size), dtype=np.intp)
    heights = np.zeros((MAX_CANDIDATES, columns.size), dtype=np.float32)
    around = np.arange(-distance, distance + 1)[:, None]
    for i in range(MAX_CANDIDATES):
        rows[i] = peak.argmax(axis=0)
        heights[i] = peak[rows[i], every]
        peak[np.clip(rows[i] + around, 0, len(peak) - 1), every] = 0
    return rows, heights


def smooth_light(light: Array) -> Array:
    """SCALE times the light (rows, columns), averaged over COLUMN_MEAN_PX columns and the ROW_MEAN_PX rows."""
    return np.asarray(cv2.boxFilter(light, -1, (COLUMN_MEAN_PX, ROW_MEAN_PX), normalize=False))


def smooth_wide(light: Array, sigma: float) -> Array:
    """The same with a Gaussian of this sigma [px] over rows."""
    taps = ROW_MEAN_PX * cv2.getGaussianKernel(2 * int(np.ceil(2 * sigma)) + 1, sigma)
    return np.asarray(cv2.sepFilter2D(light, -1, np.ones(COLUMN_MEAN_PX), taps, borderType=cv2.BORDER_REPLICATE))


def noise_of_columns(light: Array) -> float:
    """Standard deviation of sums of COLUMN_MEAN_PX columns of light (rows, columns)."""
    sums = sums_of_columns(light, SAMPLE_ROWS, SAMPLE_COLUMNS)
    return max(robust_sigma(sums) if sums.size else 0.0, LEAST_NOISE * COLUMN_MEAN_PX)


def sums_of_columns(light: Array, rows: int, columns: int) -> Array:
    """Sums of COLUMN_MEAN_PX columns at intervals of rows and columns: what smoothing over rows starts from."""
    some = light[::rows]
    count = (light.shape[1] - COLUMN_MEAN_PX) // columns + 1
    first, second, third = (some[:, shift : shift + count * columns : columns] for shift in range(COLUMN_MEAN_PX))
    return np.asarray(first + second + third)
