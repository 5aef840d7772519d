"""Peaks of a band of laser light, their threshold, width and sub-pixel centres; medians."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np

from guara_perception.arrays import Array, Float32, Index
from guara_perception.stripes.band import SAMPLE_COLUMNS, SAMPLE_ROWS
from guara_perception.stripes.kernel.library import address, addresses, kernel

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
# How far from the top the crossing may be, and the grid of shifts from the top at which the filter answers: so fine
# that a straight line in between is exact enough. As in measure.c.
SEARCH_PX = 1.5
GRID_PX = 0.5
SHIFTS = 7
# The filter is cut where it has fallen to 4 %.
FILTER_SIGMAS = 2.5


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
        smooth: (rows, columns) float32 or int16 laser light.
        top, columns, height: (n,) some peaks.
        smoothed_by: sigma of the Gaussian that the light was smoothed by over rows [px].
    """
    top, columns, height = (np.ascontiguousarray(a, t) for a, t in zip((top, columns, height), "qqf", strict=True))
    work = np.empty(top.size, np.float32)
    pointers = addresses(top, height, columns)
    return float(kernel().stripe_sigma(*_light(smooth), *pointers, top.size, smoothed_by**2, address(work)))


def responses(light: Array, top: Index, sigma: float) -> Float32:
    """Responses of the derivative filters about each top: positive above the centre of a stripe, negative below it.

    Args:
        light: (rows, columns) float32 or int16 laser light.
        top: (columns,) peaks.
        sigma: sigma of the filter [px], that of the stripe.

    Returns:
        (SHIFTS, columns), from which the kernel measures the centre.
    """
    filters, top = derivative_filters(sigma), np.ascontiguousarray(top, np.int64)
    out = np.empty((SHIFTS, light.shape[1]), np.float32)
    kernel().responses(*_light(light), *addresses(top, filters), filters.shape[1], address(out))
    return out


def _light(light: Array) -> tuple[int, bool, int, int]:
    """Address of light, whether it is of float32 and not of int16, and its size."""
    return address(light), light.dtype == np.float32, *light.shape


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
