"""The sub-pixel centre of a stripe: zero crossing of the derivative of a matched Gaussian filter."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from guara_perception.stripes.middle import middle

Float32 = npt.NDArray[np.float32]
Index = npt.NDArray[np.intp]

# The crossing is sought this far from the top, on a grid so fine that a straight line in between is exact enough.
SEARCH_PX = 1.5
GRID_PX = 0.5
# The filter is cut where it has fallen to 4 %.
FILTER_SIGMAS = 2.5
# Widths of stripes that make sense: the lens never images a line sharper than the first.
LEAST_SIGMA_PX, LARGEST_SIGMA_PX = 1.0, 8.0
FWHM_PER_SIGMA = 2.3548


def stripe_sigma(light: npt.NDArray[Any], top: Index, columns: Index, height: Float32) -> float:
    """Typical width of a stripe as the sigma of a Gaussian [px], from the rows above half the peak.

    Args:
        light: (rows, columns) laser light.
        top, columns, height: (n,) some peaks.
    """
    reach = int(np.ceil(FWHM_PER_SIGMA * LARGEST_SIGMA_PX))
    around = np.arange(-reach, reach + 1)[:, None]
    window = light[np.clip(top + around, 0, len(light) - 1), columns]
    above = window > 0.5 * height
    # Only the unbroken stretch around the top counts, not a second stripe further off.
    down = np.cumprod(above[reach:], axis=0).sum(axis=0)
    up = np.cumprod(above[reach::-1], axis=0).sum(axis=0)
    width = middle(up + down - 1) if top.size else FWHM_PER_SIGMA * LEAST_SIGMA_PX
    return float(np.clip(width / FWHM_PER_SIGMA, LEAST_SIGMA_PX, LARGEST_SIGMA_PX))


def centres(light: npt.NDArray[Any], top: Index, columns: Index, sigma: float) -> tuple[Float32, Float32]:
    """Where the filtered light peaks.

    Args:
        light: (rows, columns) laser light.
        top, columns: (n,) peaks.
        sigma: of the filter, that of the stripe [px].

    Returns:
        (n,) rows, NaN where there is no crossing near the top, and (n,) standard deviation of the row for noise of
        one grey level per pixel.
    """
    filters = derivative_filters(sigma)
    reach = filters.shape[1] // 2
    around = np.arange(-reach, reach + 1)[:, None]
    window = light[np.clip(top + around, 0, len(light) - 1), columns].astype(np.float32)
    response = filters @ window
    falling = (response[:-1] > 0) & (response[1:] <= 0)
    steps = len(filters) - 1
    # Of several crossings the one nearest to the top.
    nearest = (steps - np.abs(np.arange(steps) - (steps - 1) / 2)).astype(np.float32)
    place = (falling * nearest[:, None]).argmax(axis=0)
    every = np.arange(top.size)
    before, after = response[place, every], response[place + 1, every]
    slope = np.maximum(before - after, 1e-9)
    offset = (place + before / slope) * GRID_PX - SEARCH_PX
    noise = float(np.sqrt((filters[steps // 2] ** 2).sum()))
    found = falling[place, every]
    row = np.where(found, top + offset, np.nan).astype(np.float32)
    return row, np.where(found, noise * GRID_PX / slope, np.nan).astype(np.float32)


@lru_cache(maxsize=64)
def derivative_filters(sigma: float) -> Float32:
    """Derivatives of a Gaussian about each place of the search grid, (places, window) float32."""
    reach = int(np.ceil(FILTER_SIGMAS * sigma + SEARCH_PX))
    places = np.arange(-SEARCH_PX, SEARCH_PX + GRID_PX / 2, GRID_PX)
    distance = np.arange(-reach, reach + 1) - places[:, None]
    weights = distance * np.exp(-0.5 * (distance / sigma) ** 2)
    weights[np.abs(distance) > FILTER_SIGMAS * sigma + 0.5] = 0.0
    # A background that is constant must not move the crossing, wherever the window is cut.
    weights -= weights.mean(axis=1, keepdims=True)
    filters = weights.astype(np.float32)
    filters.setflags(write=False)
    return filters
