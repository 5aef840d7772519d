"""The `precise` method: highest peak of each column; doubtful bands go to the detector for any light."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from guara_perception.arrays import Array, Float, Float32, Index, Mask
from guara_perception.stripes.any_light.detect_stripe import detect_in_any_light
from guara_perception.stripes.band import MAX_AMBIENT_CHANGE, Band, StripeProfile, bad_frame, pictures_of
from guara_perception.stripes.kernel.library import addresses, kernel, memory
from guara_perception.stripes.measure import measure, profile_of

# Results that are no numbers of doubtful columns, as in extract.c.
SWAPPED, CHANGED = -2, -3


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
    if band.off is None:
        return measure(detect_in_any_light(band))
    first, second = pictures_of(band.on, band.off)
    rows, n, channels = first.shape
    work, full_scale = memory(kernel().clean_size(rows, n, channels)), float(np.iinfo(band.on.dtype).max)
    profile, status = np.empty((3, n), np.float32), np.empty(n, np.uint8)
    given = (first, second, band.first_row, MAX_AMBIENT_CHANGE * full_scale)
    doubts = kernel().extract_clean(*given, *addresses(work, profile, status))
    if doubts == 0:
        return profile_of(profile, status)
    found = ClearStripe.of(work, n)
    if doubts > 0:
        return profile_of(profile, status, found.doubtful.copy())
    if doubts == SWAPPED:
        reason = "the stripe is darker than its surroundings: laser-on and laser-off frames are swapped"
        return bad_frame(n, reason)
    if doubts == CHANGED:
        change = f"{found.told[2]:+.0f} of {full_scale:.0f}"
        remark = f"brightness beside the stripe changed by {change} between laser off and on"
        return measure(replace(detect_in_any_light(band, is_changed=True), remark=remark))
    return measure(detect_in_any_light(band, found.top.copy(), found.masks[0].copy()))


class ClearStripe(NamedTuple):
    """Findings on the highest peaks of a band; views of memory that the next band of the thread overwrites.

    Attributes:
        told: what was judged, then the stripe's width [px] and the noise of a response.
        top: (columns,) row of the peak within the band.
        height: (columns,) float32 light at the peak, sum of 9 pixels.
        doubtful: (columns,) float32 row of a return that may not be used, NaN where there is none.
        masks: (3, columns) whether there is a peak, its core is clipped, and it is unsure.
    """

    told: Float
    top: Index
    height: Float32
    doubtful: Float32
    masks: Mask

    @classmethod
    def of(cls, work: Array, n: int) -> ClearStripe:
        """Read the beginning of the kernel's memory, as extract.c has it, after a band of n columns."""
        ends = np.cumsum((64, 8 * n, 4 * n, 4 * n, 3 * n))
        told, top, height, doubtful, masks = np.split(work[: ends[-1]], ends[:-1])
        masks = masks.view(np.bool_).reshape(3, n)
        return cls(told.view(float), top.view(np.intp), height.view(np.float32), doubtful.view(np.float32), masks)
