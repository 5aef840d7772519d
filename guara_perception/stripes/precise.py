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
from guara_perception.stripes.seek import SoughtStripe, seek
from guara_perception.stripes.smooth_line import smooth_line

Float32 = npt.NDArray[np.float32]

# Speckle moves the centre of a stripe by this share of its sigma, whatever the light.
SPECKLE_OF_SIGMA = 0.06
# A surface that is brighter on one side of the stripe pulls its centre over: share of the first-order shift.
ALBEDO_SHARE = 0.5


def extract_precise(bands: Sequence[Band]) -> list[StripeProfile]:
    """Find the stripes of some bands, which run across their columns.

    Each by itself; several of one width at once only share the fixed cost of numpy's calls.

    Args:
        bands: one for each stripe.

    Returns:
        For each band one position per column in full-picture rows.
    """
    sought = [seek(band) for band in bands]
    of_width: dict[int, list[SoughtStripe]] = {}
    for stripe in sought:
        if not isinstance(stripe, str):
            of_width.setdefault(stripe.top.size, []).append(stripe)
    found = {width: iter(_located(stripes)) for width, stripes in of_width.items()}
    return [
        bad_frame(band.on.frame.shape[1], stripe) if isinstance(stripe, str) else next(found[stripe.top.size])
        for band, stripe in zip(bands, sought, strict=True)
    ]


def _located(stripes: Sequence[SoughtStripe]) -> list[StripeProfile]:
    """Profiles of stripes with as many columns each; arrays in here are (stripes, columns)."""
    top = _stacked([stripe.top for stripe in stripes])
    height = _stacked([stripe.height for stripe in stripes])
    is_peak = _stacked([stripe.is_peak for stripe in stripes])
    sigma, noise, rows, first_row = np.array(
        [(s.sigma, s.noise, s.rows, s.first_row) for s in stripes], dtype=np.float32
    ).T[:, :, None]
    from_top, slope = centres(_stacked([stripe.responses for stripe in stripes], axis=1))
    row = np.where(is_peak, top + from_top, np.float32(np.nan)).astype(np.float32)
    is_found = np.isfinite(row)
    status = _status(stripes, is_peak, is_found, (top < 2) | (top > rows - 3))
    usable = (status == StripeStatus.OK) | (status == StripeStatus.SATURATED)
    row, shrink = smooth_line(row, height)
    row += first_row
    variance = (noise * shrink / slope) ** 2 + (SPECKLE_OF_SIGMA * sigma) ** 2 * shrink + _albedo_shift(stripes) ** 2
    is_doubtful = is_found & ~usable
    has_doubtful = is_doubtful.any(axis=1)
    nan = np.float32(np.nan)
    position, deviation = np.where(usable, row, nan), np.where(usable, np.sqrt(variance), nan)
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
            doubtful_px=np.where(is_doubtful[i], row[i], nan) if has_doubtful[i] else nothing(top.shape[1]),
        )
        for i in range(len(stripes))
    ]


def _status(
    stripes: Sequence[SoughtStripe],
    is_peak: npt.NDArray[np.bool_],
    is_found: npt.NDArray[np.bool_],
    is_cut: npt.NDArray[np.bool_],
) -> npt.NDArray[np.uint8]:
    """StripeStatus; the last word is the one that counts."""
    status = np.where(is_found, np.uint8(StripeStatus.OK), np.uint8(StripeStatus.DROPOUT))
    for of_stripe, found, stripe in zip(status, is_found, stripes, strict=True):
        of_stripe[found & stripe.is_clipped] = StripeStatus.SATURATED
        of_stripe[found & (stripe.is_ambiguous | stripe.is_lost)] = StripeStatus.AMBIGUOUS
    status[is_peak & ~is_found] = StripeStatus.AMBIGUOUS
    status[is_peak & is_cut] = StripeStatus.OUT_OF_BAND
    return status


def _albedo_shift(stripes: Sequence[SoughtStripe]) -> Float32:
    """How far the brightness gradient of the surface may have pulled the centre [px].

    Reflectance that changes by a factor exp(g) per row shifts a Gaussian stripe by g sigma^2 rows. The laser-off
    picture shows the reflectance under ambient light, noise included, hence only a share of it.
    """
    above, below = _stacked([stripe.beside for stripe in stripes], axis=1).astype(np.float32)
    pull = np.array([[ALBEDO_SHARE * stripe.sigma**2 / stripe.beside_px] for stripe in stripes], dtype=np.float32)
    return np.asarray(pull * (below - above) / np.maximum(above + below, np.float32(1)))


def _stacked(arrays: Sequence[npt.NDArray[Any]], axis: int = 0) -> npt.NDArray[Any]:
    """The arrays along a new axis; a single one is not copied."""
    return np.expand_dims(arrays[0], axis) if len(arrays) == 1 else np.stack(arrays, axis)
