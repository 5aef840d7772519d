"""Measurement of detected stripes: sub-pixel centre and sigma in every column, or the reason for none."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from guara_perception.arrays import Array, Float32, Image, Index, Mask
from guara_perception.stripes.band import StripeProfile, nothing
from guara_perception.stripes.kernel.library import Picture, address, addresses, kernel

NAN = np.float32(np.nan)
# Averaging three columns before looking for the peak halves the noise of a dim stripe.
COLUMN_MEAN_PX = 3
# Three rows lose next to nothing of a thin stripe's peak; a wide stripe is smoothed to its own width.
ROW_MEAN_PX = 3
# Sigma of that mean [px].
ROW_SMOOTHING_SIGMA_PX = float(np.sqrt(2 / 3))
# Sums instead of means keep the fractions of a grey level in whole numbers.
SCALE = COLUMN_MEAN_PX * ROW_MEAN_PX
# How far from the top the crossing may be, and the grid of shifts from the top at which the filter answers: so fine
# that a straight line in between is exact enough. As in measure.c.
SEARCH_PX = 1.5
GRID_PX = 0.5
SHIFTS = 7
# The filter is cut where it has fallen to 4 %.
FILTER_SIGMAS = 2.5


@dataclass(frozen=True, slots=True)
class DetectedStripe:
    """A detected stripe, column by column, before its centre is measured.

    Attributes:
        top: (columns,) row of the stripe's peak within the band.
        height: (columns,) float32 light at the peak, times SCALE.
        is_peak: (columns,) whether the height is above the detection threshold.
        is_clipped: (columns,) whether the stripe's core is clipped.
        is_unsure: (columns,) whether another peak is as good, or nothing is left of a clipped core.
        responses: (shifts, columns) responses of the derivative filters about the top.
        background: (rows, columns[, channels]) laser-off picture; None if there is none or it cannot be used.
        channel: the channel of `background` that the laser lights most.
        sigma: width of the stripe [px].
        noise: standard deviation of a response; divided by the slope of the response, that of the row.
        rows: number of rows of the band.
        first_row: first row of the band in the full picture.
        remark: reason why the laser-off picture was not used; empty if it was used or there was none.
    """

    top: Index
    height: Float32
    is_peak: Mask
    is_clipped: Mask
    is_unsure: Mask
    responses: Float32
    background: Image | None
    channel: int
    sigma: float
    noise: float
    rows: int
    first_row: int
    remark: str = ""


def sigma_of_filter(sigma: float) -> float:
    """Width of the filter that finds the centre of a stripe of this width in smoothed light [px].

    For a thin stripe it is wider than the stripe, because of speckle; for a wide one (clipped or in a halo) it is
    narrower, because the core is the most accurate part. The smoothing already applied to the light is subtracted.
    """
    return round(float(np.sqrt((0.85 * sigma) ** 2 + 1.3**2 - ROW_SMOOTHING_SIGMA_PX**2)), 1)


def measure(stripe: DetectedStripe) -> StripeProfile:
    """Measure the profile of a stripe."""
    columns = stripe.top.size
    background = None if stripe.background is None else Picture(stripe.background)
    top, height = np.ascontiguousarray(stripe.top, np.int64), np.ascontiguousarray(stripe.height, np.float32)
    masks = [np.ascontiguousarray(mask, np.bool_) for mask in (stripe.is_peak, stripe.is_clipped, stripe.is_unsure)]
    responses = np.ascontiguousarray(stripe.responses, np.float32)
    position, sigma, doubtful = np.empty((3, columns), np.float32)
    work, status = np.empty(3 * columns, np.float32), np.empty(columns, np.uint8)
    doubts = kernel().measure(
        *addresses(top, height, *masks, responses),
        background,
        *(stripe.channel, columns, stripe.rows, stripe.first_row, stripe.sigma, stripe.noise),
        *addresses(work, position, sigma, status, doubtful),
    )
    peak = height / np.float32(SCALE)
    for array in (position, sigma, status, peak, doubtful):
        # Read-only arrays are not copied by the profiles.
        array.setflags(write=False)
    return StripeProfile(position, sigma, status, peak, doubtful if doubts else nothing(columns), remark=stripe.remark)


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
    kernel().responses(*light_of(light), *addresses(top, filters), filters.shape[1], address(out))
    return out


def light_of(light: Array) -> tuple[int, bool, int, int]:
    """Address of light (rows, columns), True for float32 and False for int16, and its size."""
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
