"""The `precise` method: highest peak of each column; doubtful bands go to the detector for any light."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from guara_perception.stripes.any_light.detect_stripe import detect_in_any_light
from guara_perception.stripes.band import Band, StripeProfile, bad_frame, has_colour
from guara_perception.stripes.kernel.library import addresses, kernel
from guara_perception.stripes.laser_light import MAX_AMBIENT_CHANGE, judge, pictures_of
from guara_perception.stripes.measure import (
    ROW_MEAN_PX,
    DetectedStripe,
    measure,
    noise_gain,
    responses,
    sigma_of_filter,
)


def extract_precise(bands: Sequence[Band]) -> list[StripeProfile]:
    """Find the stripe in each band.

    Bands are independent of each other.

    Args:
        bands: one band per stripe, all of the same width.

    Returns:
        Profile of each band: one position per column, in rows of the full picture.
    """
    return [_extract(band) for band in bands]


def _extract(band: Band) -> StripeProfile:
    """Profile of one band."""
    stripe = detect(band)
    return bad_frame(band.on.shape[1], stripe) if isinstance(stripe, str) else measure(stripe)


def detect(band: Band) -> DetectedStripe | str:
    """Detect the stripe of a band, row by column; returns the reason as text if its frames cannot be used."""
    if band.off is None:
        return detect_in_any_light(band)
    seen = judge(band.on, band.off)
    full_scale = float(np.iinfo(band.on.dtype).max)
    if seen.is_swapped:
        return "the stripe is darker than its surroundings: laser-on and laser-off frames are swapped"
    if abs(seen.change) > MAX_AMBIENT_CHANGE * full_scale:
        change = f"{seen.change:+.0f} of {full_scale:.0f}"
        remark = f"brightness beside the stripe changed by {change} between laser off and on"
        return replace(detect_in_any_light(replace(band, off=None)), remark=remark)
    rows, columns = band.on.shape[:2]
    is_fused = seen.is_core_clipped and has_colour(band.on)
    smooth = np.empty((rows, columns), np.float32 if is_fused or band.on.dtype == np.uint16 else np.int16)
    work, found = np.empty(kernel().find_size(rows, columns, smooth.itemsize), np.uint8), np.empty(2)
    top, height = np.empty(columns, np.int64), np.empty(columns, np.float32)
    is_peak, is_clipped, is_unsure = np.empty((3, columns), np.bool_)
    is_doubtful = kernel().find_stripe(
        *pictures_of(band.on, band.off),
        *(seen.channel, smooth.dtype == np.float32, is_fused, seen.is_uneven),
        *addresses(work, smooth, top, height, is_peak, is_clipped, is_unsure, found),
    )
    if is_doubtful:
        return detect_in_any_light(band, top, is_peak)
    sigma, noise = found.tolist()
    width = sigma_of_filter(sigma)
    return DetectedStripe(
        top=top,
        height=height,
        is_peak=is_peak,
        is_clipped=is_clipped,
        is_unsure=is_unsure,
        responses=responses(smooth, top, width),
        background=band.off,
        channel=seen.channel,
        sigma=sigma,
        noise=noise * noise_gain(width, ROW_MEAN_PX),
        rows=rows,
        first_row=band.first_row,
    )
