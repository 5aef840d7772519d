"""The sub-pixel centre of a stripe: zero crossing of the derivative of a matched Gaussian filter."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from guara_perception.arrays import Array, Float32, Index
from guara_perception.stripes.band import rows_from
from guara_perception.stripes.median import upper_median

# How far from the top the crossing may be, and the grid of shifts from the top at which the filter answers: so fine
# that a straight line in between is exact enough.
SEARCH_PX = 1.5
GRID_PX = 0.5
# Intervals of the grid ranked by their distance from the top, the nearest last.
INTERVALS = round(2 * SEARCH_PX / GRID_PX)
INTERVAL_OF_RANK = np.argsort(-np.abs(2 * np.arange(INTERVALS) - (INTERVALS - 1)), kind="stable")
RANK_OF_INTERVAL = np.argsort(INTERVAL_OF_RANK).astype(np.int8)
# The filter is cut where it has fallen to 4 %.
FILTER_SIGMAS = 2.5
# Widths of stripes that make sense: the lens never images a line sharper than the first.
LEAST_SIGMA_PX, LARGEST_SIGMA_PX = 1.0, 8.0
FWHM_PER_SIGMA = 2.3548


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
    """What the derivative filters about each top answer: positive above the centre of a stripe, negative below it.

    Args:
        light: (rows, columns) laser light.
        top, columns: (n,) peaks.
        sigma: sigma of the filter [px], that of the stripe.

    Returns:
        (shifts, n), to be given to `centres`.
    """
    filters = derivative_filters(sigma)
    size = filters.shape[1]
    return np.asarray(filters @ rows_from(light, top - size // 2, size, columns).astype(np.float32))


def centres(response: Float32) -> tuple[Float32, Float32]:
    """Where the filtered light peaks: the response crosses zero.

    Args:
        response: (shifts, ...) responses of the filters.

    Returns:
        (...) rows from the top on, NaN where there is no crossing near it, and (...) by how much the response falls
        there from one shift to the next.
    """
    others = response.shape[1:]
    response = response.reshape(len(response), -1)
    is_above = response > 0
    falling = is_above[:-1] > is_above[1:]
    # Of several crossings the one nearest to the top.
    interval = INTERVAL_OF_RANK.take((falling * RANK_OF_INTERVAL[:, None]).max(axis=0))
    flat = interval * response.shape[1] + np.arange(response.shape[1])
    before, after = response.take(flat), response.take(flat + response.shape[1])
    slope = np.maximum(before - after, np.float32(1e-9))
    crossing = (interval + before / slope).astype(np.float32)
    row = crossing * np.float32(GRID_PX) - np.float32(SEARCH_PX)
    row[~falling.take(flat)] = np.nan
    return row.reshape(others), slope.reshape(others)


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
