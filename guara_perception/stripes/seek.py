"""Seeks one stripe in a band: which peak of each column it is, and what tells of its exact place there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from guara_perception.stripes.band import Band
from guara_perception.stripes.centre import noise_gain, responses
from guara_perception.stripes.choose import choose_peaks
from guara_perception.stripes.clipped import clipped_columns
from guara_perception.stripes.filters import ROW_MEAN_PX, ROW_SMOOTHING_SIGMA_PX
from guara_perception.stripes.find_peaks import find_peaks
from guara_perception.stripes.signal import laser_light
from guara_perception.stripes.windows import at_rows

Float32 = npt.NDArray[np.float32]
Index = npt.NDArray[np.intp]
Mask = npt.NDArray[np.bool_]

# The surface is looked at so many sigmas above and below the stripe, two rows away at least.
BESIDE_SIGMAS, LEAST_BESIDE_PX = 1.5, 2


@dataclass(frozen=True, slots=True)
class SoughtStripe:
    """What a band says of its stripe, column by column.

    Attributes:
        top: (columns,) row of the stripe's peak within the band.
        height: (columns,) float32 light there, times SCALE.
        is_peak: (columns,) whether that is enough for a stripe.
        is_clipped: (columns,) whether the stripe's core is clipped.
        is_unsure: (columns,) whether another peak would have been as good, or nothing is left of a clipped core.
        responses: (places, columns) of the derivative filters about the top.
        above, below: (columns,) the laser-off picture above and below the top; nothing where there is none.
        beside_px: how far above and below.
        sigma: width of the stripe [px].
        noise: standard deviation of a row times the slope of its response.
        rows: of the band.
        first_row: of the band in the full picture.
    """

    top: Index
    height: Float32
    is_peak: Mask
    is_clipped: Mask
    is_unsure: Mask
    responses: Float32
    above: npt.NDArray[Any]
    below: npt.NDArray[Any]
    beside_px: int
    sigma: float
    noise: float
    rows: int
    first_row: int


def seek(band: Band) -> SoughtStripe | str:
    """Seek a stripe that runs across the columns of a band; a text says why the pair of frames cannot be used."""
    signal = laser_light(band.on, band.off)
    if signal.reason:
        return signal.reason
    found = find_peaks(signal.light)
    sigma = found.sigma
    choice = choose_peaks(found.sought, found.peaks, found.threshold, sigma)
    columns = np.arange(choice.top.size)
    is_clipped, is_unsure = np.zeros(columns.size, dtype=bool), choice.is_ambiguous
    if signal.is_clipped:
        is_clipped, is_lost = clipped_columns(signal.frame, choice.top, sigma, signal.channel, is_fused=signal.is_fused)
        is_unsure = is_unsure | is_lost
    beside_px = max(int(round(BESIDE_SIGMAS * sigma)), LEAST_BESIDE_PX)
    above = below = np.zeros(columns.size, np.uint8)
    if signal.background is not None:
        above = at_rows(signal.background, choice.top - beside_px, columns, signal.channel)
        below = at_rows(signal.background, choice.top + beside_px, columns, signal.channel)
    width = sigma_of_filter(sigma)
    return SoughtStripe(
        top=choice.top,
        height=choice.height,
        is_peak=choice.height > found.threshold,
        is_clipped=is_clipped,
        is_unsure=is_unsure,
        responses=responses(found.smooth, choice.top, columns, width),
        above=above,
        below=below,
        beside_px=beside_px,
        sigma=sigma,
        noise=found.noise * noise_gain(width, ROW_MEAN_PX),
        rows=len(signal.light),
        first_row=band.first_row,
    )


def sigma_of_filter(sigma: float) -> float:
    """Width of the filter that finds the centre of a stripe of this width in smoothed light [px].

    Speckle makes a thin stripe's own width too narrow a window; of a wide one, clipped or in a halo, the core is best.
    What the light was smoothed by already counts as part of it.
    """
    return round(float(np.sqrt((0.85 * sigma) ** 2 + 1.3**2 - ROW_SMOOTHING_SIGMA_PX**2)), 1)
