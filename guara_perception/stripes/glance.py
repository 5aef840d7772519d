"""A glance at a whole frame: where its brightest light is, and whether its pixels are those of a colour filter."""

from __future__ import annotations

import numpy as np

from guara_perception.arrays import Float, Image, Index

# Light counts when it stands this far above what is usual in its column.
LEAST_LEVEL = 12.0
LEAST_SIGMAS = 8.0
ROWS_APART = 2
# What is usual in a column shows in every eighth of those rows.
USUAL_ROWS_APART = 8
# Columns of a grey picture differ from their neighbours by a thousandth, those behind a colour filter by 2 %
# under white light at the least, and by 30 to 95 % of its light in a red laser's.
LEAST_AMBIENT_CONTRAST = 0.012
LEAST_LASER_CONTRAST = 0.25
LEAST_LASER_LEVEL = 0.15
QUARTERS = 4


def brightest_rows(on: Image, off: Image | None, columns: Index) -> Float:
    """Row of the brightest light in some columns (n,) of a whole frame [px]; NaN where none stands out.

    Args:
        on: (h, w) or (h, w, 3), laser on.
        off: the same with the laser off, or None.
        columns: (n,) columns to look at.
    """
    seen = on[::ROWS_APART, columns].astype(np.float32)
    if off is not None and off.shape == on.shape:
        seen -= off[::ROWS_APART, columns]
    if seen.ndim == 3:
        seen = seen.max(axis=2)
    if on.dtype == np.uint16:
        seen /= 257.0
    some = seen[::USUAL_ROWS_APART]
    usual = np.median(some, axis=0)
    noise = np.median(np.abs(some - usual), axis=0)
    row = seen.argmax(axis=0)
    height = seen[row, np.arange(len(columns))] - usual
    return np.where(height > np.maximum(LEAST_LEVEL, LEAST_SIGMAS * noise), ROWS_APART * row, np.nan)


def is_raw_bayer(on: Image, off: Image | None) -> bool:
    """Whether a picture of one channel, or its rows from an even one on, shows the 2 x 2 pattern of a colour filter.

    Grey pictures have no reason to differ between even and odd columns all over; behind a colour filter these differ,
    in even rows otherwise than in odd ones.
    """
    if on.ndim == 3 and on.shape[2] != 1:
        return False
    if off is None or off.shape != on.shape:
        return _agree(_of_sums(_sums(on)), LEAST_AMBIENT_CONTRAST)
    dark = _sums(off)
    light = _sums(on) - dark
    # Rows of one kind hardly take in the laser: each kind is judged by itself, and only where there is more than noise.
    apart = np.abs(light[..., 0] - light[..., 1]) / (on.shape[0] / 2 * on.shape[1] / QUARTERS)
    laser = np.where(apart > LEAST_LASER_LEVEL, _of_sums(light), 0.0)
    return _agree(laser, LEAST_LASER_CONTRAST) or _agree(_of_sums(dark), LEAST_AMBIENT_CONTRAST)


def _sums(picture: Image) -> Float:
    """(2 kinds of row, QUARTERS of the width, 2 kinds of column) sums of levels."""
    height, width = picture.shape[0] // 2 * 2, picture.shape[1] // (2 * QUARTERS) * 2 * QUARTERS
    plane = picture.reshape(picture.shape[:2])[:height, :width]
    by_column = np.array([plane[row::2].sum(axis=0, dtype=np.float64) for row in (0, 1)])
    return by_column.reshape(2, QUARTERS, -1, 2).sum(axis=2)


def _of_sums(sums: Float) -> Float:
    """(2, QUARTERS) difference over sum of even and odd columns."""
    return np.asarray((sums[..., 0] - sums[..., 1]) / np.maximum(np.abs(sums).sum(axis=-1), 1e-9))


def _agree(contrast: Float, least: float) -> bool:
    """Whether one kind of row differs by more than `least`, with one sign, in all quarters but one at the most."""
    more, less = (contrast > least).sum(axis=1), (contrast < -least).sum(axis=1)
    return bool((np.maximum(more, less) >= QUARTERS - 1).any())
