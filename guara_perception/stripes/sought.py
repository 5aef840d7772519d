"""What a band says of its stripe, column by column, before the centre is measured."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from guara_perception.stripes.filters import ROW_SMOOTHING_SIGMA_PX

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


def sigma_of_filter(sigma: float) -> float:
    """Width of the filter that finds the centre of a stripe of this width in smoothed light [px].

    Speckle makes a thin stripe's own width too narrow a window; of a wide one, clipped or in a halo, the core is best.
    What the light was smoothed by already counts as part of it.
    """
    return round(float(np.sqrt((0.85 * sigma) ** 2 + 1.3**2 - ROW_SMOOTHING_SIGMA_PX**2)), 1)
