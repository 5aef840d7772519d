"""The `precise` method: sub-pixel stripe centre per column with a sigma, or an honest reason why there is none."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from guara_perception.stripes.band import Band
from guara_perception.stripes.centre import centres
from guara_perception.stripes.filters import SCALE
from guara_perception.stripes.profile import StripeProfile, StripeStatus, bad_frame, nothing
from guara_perception.stripes.seek import seek
from guara_perception.stripes.smooth_line import smooth_line
from guara_perception.stripes.sought import SoughtStripe

Float32 = npt.NDArray[np.float32]

OK, SATURATED, DROPOUT = (
    np.uint8(status) for status in (StripeStatus.OK, StripeStatus.SATURATED, StripeStatus.DROPOUT)
)
NAN = np.float32(np.nan)
# A peak on the first or last rows of the band may be the flank of a stripe outside.
EDGE_ROWS = 2
# Speckle moves the centre of a stripe by this share of its sigma, whatever the light.
SPECKLE_OF_SIGMA = 0.06
# A surface that is brighter on one side of the stripe pulls its centre over: share of the first-order shift.
ALBEDO_SHARE = 0.5


def extract_precise(bands: Sequence[Band]) -> list[StripeProfile]:
    """Find the stripes of some bands, which run across their columns.

    Each by itself; several at once only share the fixed cost of numpy's calls.

    Args:
        bands: one for each stripe, all of one width.

    Returns:
        For each band one position per column in full-picture rows.
    """
    sought = [seek(band) for band in bands]
    found = [stripe for stripe in sought if not isinstance(stripe, str)]
    located = iter(_located(found) if found else [])
    return [
        bad_frame(band.on.shape[1], stripe) if isinstance(stripe, str) else next(located)
        for band, stripe in zip(bands, sought, strict=True)
    ]


def _located(stripes: Sequence[SoughtStripe]) -> list[StripeProfile]:
    """Profiles of stripes with as many columns each; arrays in here are (stripes, columns)."""
    top, height, is_peak = (_stacked(stripes, name) for name in ("top", "height", "is_peak"))
    sigma, noise, first_row = _numbers(stripes, "sigma"), _numbers(stripes, "noise"), _numbers(stripes, "first_row")
    from_top, slope = centres(_stacked(stripes, "responses"))
    row = np.where(is_peak, top.astype(np.float32) + from_top, NAN)
    is_found = np.isfinite(row)
    status = np.where(is_found, np.where(_stacked(stripes, "is_clipped"), SATURATED, OK), DROPOUT)
    status[is_peak & (~is_found | _stacked(stripes, "is_unsure"))] = StripeStatus.AMBIGUOUS
    end = np.array([[stripe.rows] for stripe in stripes])
    status[is_peak & ((top < EDGE_ROWS) | (top >= end - EDGE_ROWS))] = StripeStatus.OUT_OF_BAND
    usable = (status == OK) | (status == SATURATED)
    row, shrink = smooth_line(row, height)
    row += first_row
    variance = (noise * shrink / slope) ** 2 + (SPECKLE_OF_SIGMA * sigma) ** 2 * shrink
    variance += _albedo_shift(stripes, sigma) ** 2
    is_doubtful = is_peak & ~usable
    # Without a centre the row of the peak says where the return was.
    seen = np.where(is_found, row, top + first_row)
    has_doubtful = is_doubtful.any(axis=1).tolist()
    position, deviation = np.where(usable, row, NAN), np.where(usable, np.sqrt(variance), NAN)
    peak = height / np.float32(SCALE)
    for array in (position, deviation, status, peak):
        # Nobody else has these: they need not be copied to be frozen.
        array.setflags(write=False)
    return [
        StripeProfile(
            position_px=position[i],
            sigma_px=deviation[i],
            status=status[i],
            peak=peak[i],
            doubtful_px=np.where(is_doubtful[i], seen[i], NAN) if has_doubtful[i] else nothing(top.shape[1]),
        )
        for i in range(len(stripes))
    ]


def _albedo_shift(stripes: Sequence[SoughtStripe], sigma: Float32) -> Float32:
    """How far the brightness gradient of the surface may have pulled the centre [px].

    Reflectance that changes by a factor exp(g) per row shifts a Gaussian stripe by g sigma^2 rows. The laser-off
    picture shows the reflectance under ambient light, noise included, hence only a share of it.
    """
    above, below = (_stacked(stripes, name).astype(np.float32) for name in ("above", "below"))
    pull = ALBEDO_SHARE * sigma**2 / _numbers(stripes, "beside_px")
    return np.asarray(pull * (below - above) / np.maximum(above + below, np.float32(1)))


def _stacked(stripes: Sequence[SoughtStripe], name: str) -> npt.NDArray[Any]:
    """One array of all stripes (..., stripes, columns); that of a single one is not copied."""
    arrays = [getattr(stripe, name) for stripe in stripes]
    return arrays[0][..., None, :] if len(arrays) == 1 else np.stack(arrays, axis=-2)


def _numbers(stripes: Sequence[SoughtStripe], name: str) -> Float32:
    """One number of all stripes (stripes, 1)."""
    return np.array([[getattr(stripe, name)] for stripe in stripes], dtype=np.float32)
