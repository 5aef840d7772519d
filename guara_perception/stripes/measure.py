"""Measurement of detected stripes: sub-pixel centre and sigma in every column, or the reason for none."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from guara_perception.arrays import Codes, Float32, Image, Index, Mask
from guara_perception.stripes.band import StripeProfile, nothing
from guara_perception.stripes.kernel.library import Picture, addresses, kernel

NAN = np.float32(np.nan)
# Pixels summed into one value of light, three columns by three rows: this reduces noise more than it lowers the peak of
# a thin stripe. As in kernel.h.
SCALE = 9
# Shifts about a peak at which the filters are evaluated. As in kernel.h.
SHIFTS = 7


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
        noise: standard deviation of the row, times the fall of the response from one shift to the next.
        rows: number of rows of the band.
        first_row: first row of the band in the full picture.
        remark: what is wrong with the laser-off picture, as in a StripeProfile.
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


def measure(stripe: DetectedStripe) -> StripeProfile:
    """Measure the profile of a stripe."""
    columns = stripe.top.size
    background = None if stripe.background is None else Picture(stripe.background)
    top, height = np.ascontiguousarray(stripe.top, np.int64), np.ascontiguousarray(stripe.height, np.float32)
    masks = [np.ascontiguousarray(mask, np.bool_) for mask in (stripe.is_peak, stripe.is_clipped, stripe.is_unsure)]
    responses = np.ascontiguousarray(stripe.responses, np.float32)
    profile, doubtful = np.empty((3, columns), np.float32), np.empty(columns, np.float32)
    work, status = np.empty(3 * columns, np.float32), np.empty(columns, np.uint8)
    doubts = kernel().measure(
        *addresses(top, height, *masks, responses),
        background,
        *(stripe.channel, columns, stripe.rows, stripe.first_row, stripe.sigma, stripe.noise),
        *addresses(work, profile[0], profile[1], status, doubtful),
    )
    profile[2] = height / np.float32(SCALE)
    return profile_of(profile, status, doubtful if doubts else None, stripe.remark)


def profile_of(profile: Float32, status: Codes, doubtful: Float32 | None = None, remark: str = "") -> StripeProfile:
    """Profile of a measured stripe; the arrays become read-only, so that it keeps them without a copy.

    Args:
        profile: (3, columns) position, its sigma, and the peak [grey levels].
        status, doubtful: (columns,), None where no return is doubtful.
        remark: as in a StripeProfile.
    """
    doubtful = nothing(status.size) if doubtful is None else doubtful
    for array in (profile, status, doubtful):
        array.setflags(write=False)
    position, sigma, peak = profile
    return StripeProfile(position, sigma, status, peak, doubtful, remark=remark)
