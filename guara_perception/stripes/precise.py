"""The `precise` method: highest peak of each column; in doubtful light the best path through all columns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from guara_perception.arrays import Array, Float, Float32, Index, Mask
from guara_perception.stripes.band import (
    MAX_AMBIENT_CHANGE,
    Band,
    StripeProfile,
    bad_frame,
    has_colour,
    pictures_of,
    profile_of,
)
from guara_perception.stripes.kernel.library import addresses, kernel, memory

# Results that are no numbers of doubtful columns, as in extract.c and any_light.c.
SWAPPED, CHANGED = -2, -3
EVERY_COLUMN = -1
# Columns of a picture of at least this many that become one where a path is looked for in a pair of colour pictures.
SHRUNK_FROM, SHRUNK_ROWS = ((1000, 4), (480, 2)), 32
# What is wrong with a laser-off picture, by the kernel's number, in words that take its numbers.
REMARKS = (
    "",
    "the laser-off picture is {:.2f} times as bright as the laser-on one: expose both alike",
    "the laser-off picture is of another scene: {:.0f} of {:.0f} grey levels remain",
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
    if band.off is None:
        return extract_in_any_light(band)
    first, second = pictures_of(band.on, band.off)
    rows, n, channels = first.shape
    work, full_scale = memory(kernel().clean_size(rows, n, channels)), float(np.iinfo(band.on.dtype).max)
    profile, status = np.empty((3, n), np.float32), np.empty(n, np.uint8)
    given = (first, second, band.first_row, MAX_AMBIENT_CHANGE * full_scale)
    doubts = kernel().extract_clean(*given, *addresses(work, profile, status))
    if doubts == 0:
        return profile_of(profile, status)
    found = ClearStripe(work, n)
    if doubts > 0:
        return profile_of(profile, status, found.doubtful.copy())
    if doubts == SWAPPED:
        reason = "the stripe is darker than its surroundings: laser-on and laser-off frames are swapped"
        return bad_frame(n, reason)
    if doubts == CHANGED:
        change = f"{found.told[2]:+.0f} of {full_scale:.0f}"
        remark = f"brightness beside the stripe changed by {change} between laser off and on"
        return replace(extract_in_any_light(band, is_changed=True), remark=remark)
    return extract_in_any_light(band, found.top.copy(), found.masks[0].copy())


def extract_in_any_light(
    band: Band, weak_row: Index | None = None, is_weak: Mask | None = None, *, is_changed: bool = False
) -> StripeProfile:
    """Find the stripe that runs across the columns of a band, with or without a picture with the laser off.

    Args:
        band: rows that can hold the stripe.
        weak_row, is_weak: (columns,) row of a peak that may be a stripe, and whether there is one: where no stripe is
            found these are doubtful returns.
        is_changed: whether the light changed so much that `off` must be shown to be of the same view.
    """
    first, second = pictures_of(band.on, band.off)
    rows, n, channels = first.shape
    factor = 1
    if second is not None and has_colour(band.on) and band.on.dtype == np.uint8 and rows >= SHRUNK_ROWS:
        factor = next((factor for least, factor in SHRUNK_FROM if n >= least), 1)
    profile, status, told = np.empty((3, n), np.float32), np.empty(n, np.uint8), np.empty(3)
    weak = (None, None) if weak_row is None or is_weak is None else addresses(weak_row, is_weak)

    def extract(factor: int, *, is_changed: bool) -> tuple[int, Array]:
        work = memory(kernel().any_light_size(rows, n, channels, factor, second is not None))
        given = (first, second, factor, is_changed, band.first_row, *weak)
        return kernel().extract_any_light(*given, *addresses(work, profile, status, told)), work

    doubts, work = extract(factor, is_changed=is_changed)
    if doubts == EVERY_COLUMN:
        if is_changed:
            second = None
        doubts, work = extract(1, is_changed=False)
    doubtful = work[: 4 * n].view(np.float32).copy() if doubts else None
    return profile_of(profile, status, doubtful, REMARKS[int(told[0])].format(*told[1:]))


class ClearStripe:
    """Findings on the highest peaks of a band: views of memory that the next band of the thread overwrites."""

    def __init__(self, work: Array, n: int) -> None:
        """Take the beginning of the kernel's memory, as extract.c has it, after a band of n columns."""
        self._work, self._n = work, n

    @property
    def told(self) -> Float:
        """Judgement of the pair, then the stripe's width [px] and the noise of a response."""
        return self._work[:64].view(float)

    @property
    def top(self) -> Index:
        """Row (columns,) of the peak within the band."""
        return self._work[64 : 64 + 8 * self._n].view(np.intp)

    @property
    def height(self) -> Float32:
        """Light (columns,) float32 at the peak, sum of 9 pixels."""
        return self._work[64 + 8 * self._n : 64 + 12 * self._n].view(np.float32)

    @property
    def doubtful(self) -> Float32:
        """Row (columns,) float32 of a return that may not be used, NaN where there is none."""
        return self._work[64 + 12 * self._n : 64 + 16 * self._n].view(np.float32)

    @property
    def masks(self) -> Mask:
        """Masks (3, columns) of the columns with a peak, with a clipped core, and with an unsure peak."""
        return self._work[64 + 16 * self._n : 64 + 19 * self._n].view(np.bool_).reshape(3, self._n)
