"""Columns of a grid in which layers changed."""

from __future__ import annotations

import numpy as np

from guara_perception.arrays import Array, Mask


def changed_columns(now: Array, before: Array) -> Mask:
    """Mask (nx,) of the columns of a layer (ny, nx) in which any bit differs from another layer of its type."""
    whole = np.dtype(f"u{now.itemsize}")
    return np.asarray((now.view(whole) != before.view(whole)).any(axis=0))


def widened(columns: Mask, cells: int) -> Mask:
    """Dilate a mask (nx,) of columns by a number of cells."""
    padded = np.pad(columns, cells)
    return np.asarray(np.lib.stride_tricks.sliding_window_view(padded, 2 * cells + 1).any(axis=1))


def runs(columns: Mask) -> list[slice]:
    """Runs of adjacent columns in a mask (nx,), in order."""
    ends = np.flatnonzero(np.diff(columns, prepend=False, append=False))
    return [slice(first, end) for first, end in ends.reshape(-1, 2).tolist()]
