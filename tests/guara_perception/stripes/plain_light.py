"""Light of a band by plain array operations: reference of the kernel."""

from __future__ import annotations

import cv2
import numpy as np

from guara_perception.stripes.kernel.library import address, addresses
from tests.guara_perception.stripes.kernel_parts import part

# Distance of the samples of a band's statistics in rows and columns.
SAMPLE_ROWS, SAMPLE_COLUMNS = 8, 24
# Columns and rows that are averaged, shifts about a peak at which the filters are evaluated [px], and half-width of the
# filters.
COLUMN_MEAN_PX = ROW_MEAN_PX = 3
ROW_SMOOTHING_SIGMA_PX = float(np.sqrt(2 / 3))
SCALE = COLUMN_MEAN_PX * ROW_MEAN_PX
SEARCH_PX, GRID_PX, SHIFTS = 1.5, 0.5, 7
FILTER_SIGMAS = 2.5


def robust_sigma(values: np.ndarray) -> float:
    """Standard deviation of normally distributed values, estimated by the median absolute deviation."""
    middle = np.sort(values, axis=None)[values.size // 2]
    return 1.4826 * float(np.sort(np.abs(values - middle), axis=None)[values.size // 2])


def smooth_light(light: np.ndarray) -> np.ndarray:
    """SCALE times the light (rows, columns), averaged over COLUMN_MEAN_PX columns and the ROW_MEAN_PX rows."""
    return np.asarray(cv2.boxFilter(light, -1, (COLUMN_MEAN_PX, ROW_MEAN_PX), normalize=False))


def smooth_bins(light: np.ndarray, sigma: float) -> np.ndarray:
    """Means of four rows of `smooth_light`, smoothed over rows to a stripe of this sigma [px]."""
    smooth = smooth_light(light.astype(np.float32))
    whole = np.pad(smooth, ((0, -len(smooth) % 4), (0, 0)), "edge")
    width = np.sqrt(sigma**2 - ROW_SMOOTHING_SIGMA_PX**2 - 15 / 12) / 4
    taps = cv2.getGaussianKernel(2 * int(np.ceil(2 * width)) + 1, width)
    bins = whole.reshape(-1, 4, light.shape[1]).mean(axis=1)
    return np.asarray(cv2.sepFilter2D(bins, -1, np.ones(1), taps, borderType=cv2.BORDER_REPLICATE))


def noise_of_columns(light: np.ndarray) -> float:
    """Standard deviation of sums of COLUMN_MEAN_PX columns of light (rows, columns)."""
    some = light[::SAMPLE_ROWS]
    end = ((light.shape[1] - COLUMN_MEAN_PX) // SAMPLE_COLUMNS + 1) * SAMPLE_COLUMNS
    first, second, third = (some[:, shift : shift + end : SAMPLE_COLUMNS] for shift in range(COLUMN_MEAN_PX))
    sums = first + second + third
    return max(robust_sigma(sums) if sums.size else 0.0, 0.3 * COLUMN_MEAN_PX)


def stripe_sigma(
    smooth: np.ndarray, top: np.ndarray, columns: np.ndarray, height: np.ndarray, smoothed_by: float = 0.0
) -> float:
    """Typical width of a stripe as the sigma of a Gaussian [px], from the rows above half the peak.

    Args:
        smooth: (rows, columns) float32 or int16 laser light.
        top, columns, height: (n,) some peaks.
        smoothed_by: sigma of the Gaussian that the light was smoothed by over rows [px].
    """
    top, columns, height = (np.ascontiguousarray(a, t) for a, t in zip((top, columns, height), "qqf", strict=True))
    work = np.empty(top.size, np.float32)
    pointers = addresses(top, height, columns)
    return float(part("stripe_sigma")(*light_of(smooth), *pointers, top.size, smoothed_by**2, address(work)))


def sigma_of_filter(sigma: float) -> float:
    """Width of the filter that finds the centre of a stripe of this width in smoothed light [px].

    For a thin stripe it is wider than the stripe, because of speckle; for a wide one (clipped or in a halo) it is
    narrower, because the core is the most accurate part. The smoothing already applied to the light is subtracted.
    """
    return round(float(np.sqrt((0.85 * sigma) ** 2 + 1.3**2 - ROW_SMOOTHING_SIGMA_PX**2)), 1)


def responses(light: np.ndarray, top: np.ndarray, sigma: float) -> np.ndarray:
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
    part("responses")(*light_of(light), *addresses(top, filters), filters.shape[1], address(out))
    return out


def light_of(light: np.ndarray) -> tuple[int, bool, int, int]:
    """Address of light (rows, columns), True for float32 and False for int16, and its size."""
    return address(light), light.dtype == np.float32, *light.shape


def noise_gain(sigma: float, smoothed_rows: int = 1) -> float:
    """Standard deviation of a row times the slope of its response, for noise of one grey level per pixel.

    Args:
        sigma: sigma of the filter [px].
        smoothed_rows: number of rows of the light that were added up before.
    """
    filters = derivative_filters(sigma)
    return float(np.linalg.norm(np.convolve(filters[len(filters) // 2], np.ones(smoothed_rows))) * GRID_PX)


def derivative_filters(sigma: float) -> np.ndarray:
    """Derivatives of a Gaussian about each shift of the search grid, (shifts, window) float32."""
    reach = int(np.ceil(FILTER_SIGMAS * sigma + SEARCH_PX))
    shifts = np.arange(-SEARCH_PX, SEARCH_PX + GRID_PX / 2, GRID_PX)
    distance = np.arange(-reach, reach + 1) - shifts[:, None]
    weights = distance * np.exp(-0.5 * (distance / sigma) ** 2)
    weights[np.abs(distance) > FILTER_SIGMAS * sigma + 0.5] = 0.0
    # A background that is constant must not move the crossing, wherever the window is cut.
    weights -= weights.mean(axis=1, keepdims=True)
    filters = weights.astype(np.float32)
    return filters
