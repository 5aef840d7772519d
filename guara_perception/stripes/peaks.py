"""Peaks of a band of laser light, their threshold, width and sub-pixel centres; medians."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from guara_perception.arrays import Array, Float32, Index
from guara_perception.stripes.band import SAMPLE_COLUMNS, SAMPLE_ROWS, rows_from, sampled
from guara_perception.stripes.kernel.library import LANES, address, addresses, kernel

# Makes the median of absolute deviations the standard deviation of a normal distribution.
SIGMA_PER_DEVIATION = 1.4826
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
# A second peak is at least one block of rows away from the block of the highest. As in peaks.c.
BLOCK_ROWS = 8
MAX_CANDIDATES = 4
# How far from the top the crossing may be, and the grid of shifts from the top at which the filter answers: so fine
# that a straight line in between is exact enough. As in measure.c.
SEARCH_PX = 1.5
GRID_PX = 0.5
SHIFTS = 7
# The filter is cut where it has fallen to 4 %.
FILTER_SIGMAS = 2.5
# Widths of stripes that make sense: the lens never images a line sharper than the first.
LEAST_SIGMA_PX, LARGEST_SIGMA_PX = 1.0, 8.0
FWHM_PER_SIGMA = 2.3548


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
    """Highest value per column of a band (rows, columns) of int16 or float32."""
    smooth = np.ascontiguousarray(smooth)
    rows, columns = smooth.shape
    top, (height, second) = np.empty(columns, np.int64), np.empty((2, columns), np.float32)
    work = np.empty((rows // BLOCK_ROWS + 1, LANES), smooth.dtype)
    find = {np.int16: kernel().highest_peaks_int16, np.float32: kernel().highest_peaks_float}[smooth.dtype.type]
    find(address(smooth), rows, columns, *addresses(top, height, second, work))
    return Peaks(top, height, second)


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
    some = light[::SAMPLE_ROWS]
    end = ((light.shape[1] - COLUMN_MEAN_PX) // SAMPLE_COLUMNS + 1) * SAMPLE_COLUMNS
    first, second, third = (some[:, shift : shift + end : SAMPLE_COLUMNS] for shift in range(COLUMN_MEAN_PX))
    sums = first + second + third
    return max(robust_sigma(sums) if sums.size else 0.0, LEAST_NOISE * COLUMN_MEAN_PX)


def stripe_sigma(smooth: Array, top: Index, columns: Index, height: Float32, smoothed_by: float = 0.0) -> float:
    """Typical width of a stripe as the sigma of a Gaussian [px], from the rows above half the peak.

    Args:
        smooth: (rows, columns) laser light.
        top, columns, height: (n,) some peaks.
        smoothed_by: sigma of the Gaussian that the light was smoothed by over rows [px].
    """
    reach = int(np.ceil(FWHM_PER_SIGMA * LARGEST_SIGMA_PX))
    above = rows_from(smooth, top - reach, 2 * reach + 1, columns) > np.float32(0.5) * height
    # Only the unbroken stretch around the top counts, not a second stripe further off.
    above[0] = above[-1] = False
    down, up = above[reach:].argmin(axis=0), above[reach::-1].argmin(axis=0)
    width = upper_median(up + down - 1) / FWHM_PER_SIGMA if top.size else 0.0
    return min(max(float(np.sqrt(max(width**2 - smoothed_by**2, 0.0))), LEAST_SIGMA_PX), LARGEST_SIGMA_PX)


def responses(light: Array, top: Index, columns: Index, sigma: float) -> Float32:
    """Responses of the derivative filters about each top: positive above the centre of a stripe, negative below it.

    Args:
        light: (rows, columns) laser light.
        top, columns: (n,) peaks.
        sigma: sigma of the filter [px], that of the stripe.

    Returns:
        (SHIFTS, n), from which the kernel measures the centre.
    """
    filters = derivative_filters(sigma)
    size = filters.shape[1]
    return np.asarray(filters @ rows_from(light, top - size // 2, size, columns).astype(np.float32))


@lru_cache(maxsize=64)
def noise_gain(sigma: float, smoothed_rows: int = 1) -> float:
    """Standard deviation of a row times the slope of its response, for noise of one grey level per pixel.

    Args:
        sigma: sigma of the filter [px].
        smoothed_rows: number of rows of the light that were added up before.
    """
    filters = derivative_filters(sigma)
    return float(np.linalg.norm(np.convolve(filters[len(filters) // 2], np.ones(smoothed_rows))) * GRID_PX)


@lru_cache(maxsize=64)
def derivative_filters(sigma: float) -> Float32:
    """Derivatives of a Gaussian about each shift of the search grid, (shifts, window) float32."""
    reach = int(np.ceil(FILTER_SIGMAS * sigma + SEARCH_PX))
    shifts = np.arange(-SEARCH_PX, SEARCH_PX + GRID_PX / 2, GRID_PX)
    distance = np.arange(-reach, reach + 1) - shifts[:, None]
    weights = distance * np.exp(-0.5 * (distance / sigma) ** 2)
    weights[np.abs(distance) > FILTER_SIGMAS * sigma + 0.5] = 0.0
    # A background that is constant must not move the crossing, wherever the window is cut.
    weights -= weights.mean(axis=1, keepdims=True)
    filters = weights.astype(np.float32)
    filters.setflags(write=False)
    return filters


def upper_median(values: Array) -> float:
    """Upper median of one or more values, as float32; NaN must not be among them."""
    return select(values, values.size // 2)


def select(values: Array, rank: int) -> float:
    """Value of this rank among values without NaN, as float32; the lowest has rank 0."""
    copy = np.array(values, np.float32, order="C")
    if not 0 <= rank < copy.size:
        raise IndexError(f"rank {rank} of {copy.size} values")
    return float(kernel().select_value(address(copy), copy.size, rank))


def upper_medians(rows: Array) -> Array:
    """Upper median of each row (n,) of values (n, m) without NaN."""
    half = rows.shape[1] // 2
    return np.asarray(np.partition(rows, half, axis=1)[:, half])


def robust_sigma(values: Array) -> float:
    """Standard deviation by the median absolute deviation from the median, as if the values were normal."""
    return SIGMA_PER_DEVIATION * upper_median(np.abs(values - values.dtype.type(upper_median(values))))
