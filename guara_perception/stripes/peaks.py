"""Smoothed light of a band, its noise and the width of a stripe in it; medians."""

from __future__ import annotations

import cv2
import numpy as np

from guara_perception.arrays import Array, Float32, Index
from guara_perception.stripes.band import SAMPLE_COLUMNS, SAMPLE_ROWS
from guara_perception.stripes.kernel.library import address, addresses, kernel
from guara_perception.stripes.measure import COLUMN_MEAN_PX, ROW_MEAN_PX, light_of

# Makes the median of absolute deviations the standard deviation of a normal distribution.
SIGMA_PER_DEVIATION = 1.4826
# A stripe wider than this is smoothed again to its own width.
WIDE_SIGMA_PX = 2.5
# Noise below a third of a quantum cannot be seen in whole grey levels.
LEAST_NOISE = 0.3


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
    return float(kernel().stripe_sigma(*light_of(smooth), *pointers, top.size, smoothed_by**2, address(work)))


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
