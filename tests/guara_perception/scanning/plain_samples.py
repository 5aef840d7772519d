"""Slow reference of the kernel's `levels_of` and `look_down`."""

from __future__ import annotations

import numpy as np

from guara_perception.arrays import Float, Image, Mask
from guara_perception.scanning.light_diagnosis import PIXELS_APART, ROWS_APART, STRIPE_SHARE
from guara_perception.stripes.band import is_clipped

# As in the kernel.
USUAL_ROWS_APART, LEAST_LEVEL, LEAST_SIGMAS = 8, 12.0, 8.0


def levels_of(picture: Image) -> tuple[float, float]:
    """Mean level of sampled pixels without the brightest ones, and share of them clipped in any channel."""
    thin = picture[::ROWS_APART, ::PIXELS_APART]
    count = max(round((1 - STRIPE_SHARE) * thin.size), 1)
    return float(np.sort(thin, axis=None)[:count].mean()), float(any_channel(is_clipped(thin)).mean())


def look_down(on: Image, off: Image | None, apart: int, columns: np.ndarray) -> tuple[float, Float]:
    """Number of sampled rows that the laser clips, and the brightest sampled row in some columns."""
    first, second = on[::apart, columns], None if off is None else off[::apart, columns]
    clipped = any_channel(is_clipped(first))
    seen = first.astype(np.float32)
    if second is not None:
        seen -= second
        clipped &= ~any_channel(is_clipped(second))
    seen = seen.reshape(*seen.shape[:2], -1).max(axis=2)
    if on.dtype == np.uint16:
        seen /= 257.0
    usual = np.median(seen[::USUAL_ROWS_APART], axis=0)
    noise = np.median(np.abs(seen[::USUAL_ROWS_APART] - usual), axis=0)
    row = seen.argmax(axis=0)
    height = seen.max(axis=0) - usual
    cores = clipped.sum(axis=0)
    core = float(np.median(cores[cores > 0])) if cores.any() else 0.0
    return core, np.where(height > np.maximum(LEAST_LEVEL, LEAST_SIGMAS * noise), row, np.nan)


def any_channel(values: Mask) -> Mask:
    """Mask (rows, columns) of pixels that are true in any channel."""
    return np.asarray(values.reshape(*values.shape[:2], -1).any(axis=2))
