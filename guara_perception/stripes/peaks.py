"""Finds the highest peak of every column, and all peaks of the columns that have more than one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from guara_perception.stripes.windows import rows_from

Index = npt.NDArray[np.intp]
Float32 = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]

# Maxima of blocks of rows are quick to take; the argmax is then sought in one block only.
BLOCK_ROWS = 8
MAX_CANDIDATES = 4


@dataclass(frozen=True, slots=True)
class Peaks:
    """The highest peak per column.

    Attributes:
        top: (columns,) row.
        height: (columns,) float32 value there.
        second: (columns,) float32 highest value at least one block away from the peak's block; 0 or less where none.
    """

    top: Index
    height: Float32
    second: Float32


def highest_peaks(smooth: npt.NDArray[Any]) -> Peaks:
    """Highest value per column of a band (rows, columns)."""
    blocks = _block_maxima(smooth)
    best = _row_of_maximum(blocks)
    first = best * BLOCK_ROWS
    window = rows_from(smooth, first, BLOCK_ROWS, np.arange(smooth.shape[1]))
    height = window.max(axis=0).astype(np.float32)
    apart = np.abs(np.arange(len(blocks), dtype=np.int16)[:, None] - best.astype(np.int16)) > 1
    second = (blocks * apart).max(axis=0).astype(np.float32)
    return Peaks(first + _row_of_maximum(window), height, np.minimum(second, height))


def _block_maxima(smooth: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Maxima (blocks, columns) of every BLOCK_ROWS rows; the last block may be shorter."""
    whole = smooth.shape[0] // BLOCK_ROWS * BLOCK_ROWS
    blocks = smooth[:whole].reshape(-1, BLOCK_ROWS, smooth.shape[1]).max(axis=1)
    if whole == smooth.shape[0]:
        return np.asarray(blocks)
    return np.concatenate((blocks, smooth[whole:].max(axis=0, keepdims=True)))


def _row_of_maximum(values: npt.NDArray[Any]) -> Index:
    """First row of the highest value per column; numpy's argmax along the columns takes twice as long."""
    count = np.arange(len(values), 0, -1, dtype=np.int16)[:, None]
    return np.asarray(len(values) - (count * (values == values.max(axis=0))).max(axis=0), dtype=np.intp)


def candidates(smooth: npt.NDArray[Any], columns: Index, threshold: float, distance: int) -> tuple[Index, Float32]:
    """Up to MAX_CANDIDATES local maxima of some columns, highest first.

    Args:
        smooth: (rows, all columns) smoothed light.
        columns: (n,) columns asked about.
        threshold: least height of a candidate.
        distance: candidates of one column are further apart than this [px].

    Returns:
        Rows (MAX_CANDIDATES, n) and heights (MAX_CANDIDATES, n); height 0 where a column has fewer.
    """
    part = smooth[:, columns].astype(np.float32)
    peak = part.copy()
    peak[1:][part[1:] < part[:-1]] = 0
    peak[:-1][part[:-1] < part[1:]] = 0
    peak[peak < threshold] = 0
    every = np.arange(columns.size)
    rows = np.zeros((MAX_CANDIDATES, columns.size), dtype=np.intp)
    heights = np.zeros((MAX_CANDIDATES, columns.size), dtype=np.float32)
    around = np.arange(-distance, distance + 1)[:, None]
    for i in range(MAX_CANDIDATES):
        rows[i] = peak.argmax(axis=0)
        heights[i] = peak[rows[i], every]
        peak[np.clip(rows[i] + around, 0, len(peak) - 1), every] = 0
    return rows, heights
