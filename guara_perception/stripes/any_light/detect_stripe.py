"""Detects a stripe that its highest peaks do not show: its path in a shrunk picture, then its peaks about that path."""

from __future__ import annotations

import numpy as np

from guara_perception.arrays import Image, Index, Mask
from guara_perception.stripes.any_light.stripe_path import find_path, find_path_of_pair
from guara_perception.stripes.band import Band, clipped_columns, has_colour
from guara_perception.stripes.kernel.library import Picture, addresses, kernel, memory
from guara_perception.stripes.measure import SHIFTS, DetectedStripe
from guara_perception.stripes.peaks import select

# Columns of a picture of at least this many that become one where a path is looked for in a pair of colour pictures.
SHRUNK_FROM = ((1000, 4), (480, 2))


def detect_in_any_light(
    band: Band, weak_row: Index | None = None, is_weak: Mask | None = None, *, is_changed: bool = False
) -> DetectedStripe:
    """Detect the stripe that runs across the columns of a band, with or without a picture with the laser off.

    Args:
        band: rows that can hold the stripe.
        weak_row, is_weak: (columns,) row of a peak that may be a stripe, and whether there is one: where no stripe is
            found these are doubtful returns.
        is_changed: whether the light changed so much that `off` must be shown to be of the same view.
    """
    on, off, n = band.on, band.off, band.on.shape[1]
    is_pair = off is not None and has_colour(on) and on.dtype == np.uint8
    factor = next((f for least, f in SHRUNK_FROM if n >= least), 1) if is_pair else 1
    path = None
    if off is not None and factor > 1:
        some, dark = _shrunk(on, factor), _shrunk(off, factor)
        if kernel().path_size(*some.shape[:2]):
            path = find_path_of_pair(some, dark, factor, is_changed=is_changed)
    if path is None:
        off = None if is_changed else off
        factor, path = 1, find_path(on, off)
    off = None if path.is_alone else off
    top, masks = np.empty(n, np.intp), np.empty((3, n), np.bool_)
    kernel().expand(*addresses(path.row, path.masks), path.row.size, n, *addresses(top, masks))
    use = path.sigma[path.masks[1]]
    # Of a wide stripe three quarters are as wide as this, or less.
    ridge = select(use, 3 * (use.size - 1) // 4) if use.size else 1.0
    found, height, responses = np.empty(2), np.empty(n, np.float32), np.empty((SHIFTS, n), np.float32)
    weights, gains = (np.ascontiguousarray(each, np.float64) for each in (path.weights, path.gains))
    kernel().measure_window(
        *(Picture(on), None if off is None else Picture(off)),
        *addresses(weights, gains, *masks),
        *(factor, ridge),
        *addresses(memory(4 * kernel().window_size(n)), top, height, responses, found),
    )
    is_path, is_stripe, _ = masks
    if weak_row is not None and is_weak is not None:
        top = np.where(is_path, top, weak_row)
        is_path = is_path | is_weak
    is_clipped, is_lost = clipped_columns(on, top, found[0], path.channel, is_fused=on.ndim == 3)
    return DetectedStripe(
        top=top,
        height=np.where(is_path, np.maximum(height, np.float32(1e-3)), 0).astype(np.float32),
        is_peak=is_path,
        is_clipped=is_clipped & is_path,
        is_unsure=~is_stripe | is_lost,
        responses=responses,
        background=off,
        channel=path.channel,
        sigma=float(found[0]),
        noise=float(found[1]),
        rows=len(on),
        first_row=band.first_row,
        remark=path.remark,
    )


def _shrunk(picture: Image, factor: int) -> Image:
    """The means of so many columns of a colour picture of 8 bits."""
    rows, columns = picture.shape[:2]
    line, means = memory(2 * columns), np.empty((rows, columns // factor, 3), np.uint8)
    kernel().shrink(Picture(picture), factor, *addresses(line, means))
    return means
