"""Method `precise` of stripe extraction: highest peaks of the columns or, in difficult light, the best path."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from guara_perception.arrays import Array, Float, Float32, Index, Mask
from guara_perception.stripes.band import (
    MAX_AMBIENT_CHANGE,
    Band,
    StripeProfile,
    bad_frame,
    full_scale,
    has_colour,
    pictures_of,
    profile_of,
)
from guara_perception.stripes.kernel.library import addresses, kernel, memory

# Negative return codes of the kernel. extract.c: IN_DOUBT = -1 (search for a path in any light), SWAPPED and CHANGED.
# any_light.c: EVERY_COLUMN = -1 (repeat without averaging columns). Other results are numbers of doubtful columns.
SWAPPED, CHANGED = -2, -3
EVERY_COLUMN = -1
# Averaging of columns before the path search in a pair of 8-bit colour images: (minimum image width, number of columns
# per mean). Columns of bands with fewer than SHRUNK_ROWS rows are not averaged.
SHRUNK_FROM, SHRUNK_ROWS = ((1000, 4), (480, 2)), 32
# Remarks on a defective laser-off image. The kernel returns the index of the remark, and the numbers that are inserted
# into it.
REMARKS = (
    "",
    "the laser-off picture is {:.2f} times as bright as the laser-on one: use the same exposure for both",
    "the laser-off picture shows another scene: {:.0f} of {:.0f} grey levels of contrast remain after subtraction",
)


def extract_precise(band: Band) -> StripeProfile:
    """Find the stripe in a band; positions are rows of the whole image."""
    if band.off is None:
        return extract_in_any_light(band)
    first, second = pictures_of(band.on, band.off)
    rows, n, channels = first.shape
    work, most = memory(kernel().clean_size(rows, n, channels)), float(full_scale(band.on))
    profile, status = np.empty((3, n), np.float32), np.empty(n, np.uint8)
    given = (first, second, band.first_row, MAX_AMBIENT_CHANGE * most)
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
        change = f"{found.figures[2]:+.0f} of {most:.0f}"
        remark = f"brightness beside the stripe changed by {change} between laser off and on"
        return replace(extract_in_any_light(band, is_changed=True), remark=remark)
    return extract_in_any_light(band, found.top.copy(), found.masks[0].copy())


def extract_in_any_light(
    band: Band, weak_row: Index | None = None, is_weak: Mask | None = None, *, is_changed: bool = False
) -> StripeProfile:
    """Find the best path of the stripe through the columns of a band, with or without a laser-off image.

    Args:
        band: rows that can contain the stripe.
        weak_row, is_weak: (columns,) row of a weak peak, and mask of the columns that have one. In a column without a
            stripe, this peak is reported as a doubtful return.
        is_changed: True if the light changed so much that `off` is used only if it shows the same view.
    """
    first, second = pictures_of(band.on, band.off)
    rows, n, channels = first.shape
    factor = 1
    if second is not None and has_colour(band.on) and band.on.itemsize == 1 and rows >= SHRUNK_ROWS:
        factor = next((factor for least, factor in SHRUNK_FROM if n >= least), 1)
    profile, status, fault = np.empty((3, n), np.float32), np.empty(n, np.uint8), np.empty(3)
    weak = (None, None) if weak_row is None or is_weak is None else addresses(weak_row, is_weak)

    def extract(factor: int, *, is_changed: bool) -> tuple[int, Array]:
        work = memory(kernel().any_light_size(rows, n, channels, factor, second is not None))
        given = (first, second, factor, is_changed, band.first_row, *weak)
        return kernel().extract_any_light(*given, *addresses(work, profile, status, fault)), work

    doubts, work = extract(factor, is_changed=is_changed)
    if doubts == EVERY_COLUMN:
        if is_changed:
            # The laser-off image shows another view. After a change of light, it is then not used at all.
            second = None
        doubts, work = extract(1, is_changed=False)
    doubtful = work[: 4 * n].view(np.float32).copy() if doubts else None
    return profile_of(profile, status, doubtful, REMARKS[int(fault[0])].format(*fault[1:]))


class ClearStripe:
    """Highest peaks of a band, as views of work memory that the next band in this thread overwrites."""

    def __init__(self, work: Array, n: int) -> None:
        """Wrap the beginning of the kernel's work memory, whose layout is in extract.c, for a band of n columns."""
        self._work, self._n = work, n

    @property
    def figures(self) -> Float:
        """Numbers (8,): judgement of the frame pair (5), sigma of the stripe [px], noise of a response, one unused."""
        return self._work[:64].view(float)

    @property
    def top(self) -> Index:
        """Row (columns,) of the highest peak within the band."""
        return self._work[64 : 64 + 8 * self._n].view(np.intp)

    @property
    def height(self) -> Float32:
        """Light (columns,) float32 at the peak, summed over 9 pixels."""
        return self._work[64 + 8 * self._n : 64 + 12 * self._n].view(np.float32)

    @property
    def doubtful(self) -> Float32:
        """Row (columns,) float32 of a doubtful return, which must not be used; NaN where there is none."""
        return self._work[64 + 12 * self._n : 64 + 16 * self._n].view(np.float32)

    @property
    def masks(self) -> Mask:
        """Masks (3, columns) of the columns with a peak, of those with a clipped core, and of uncertain peaks."""
        return self._work[64 + 16 * self._n : 64 + 19 * self._n].view(np.bool_).reshape(3, self._n)
