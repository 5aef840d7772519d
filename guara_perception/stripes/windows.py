"""Reads a picture at some places: evenly spread, at one row or in a window of rows in each of some columns."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

Index = npt.NDArray[np.intp]
Picture = npt.NDArray[Any]

# Statistics of a band are taken from every so many rows and columns.
SAMPLE_ROWS, SAMPLE_COLUMNS = 8, 24


def sampled(picture: Picture) -> Picture:
    """Some pixels (n, m[, channels]) of a picture, evenly spread."""
    return picture[::SAMPLE_ROWS, ::SAMPLE_COLUMNS]


def rows_from(picture: Picture, first: Index, count: int, columns: Index, channel: int = 0) -> Picture:
    """Values in a window of rows; what lies beyond the edges of the picture is taken at the edge.

    Args:
        picture: (rows, columns[, channels]).
        first: (n,) first row of the window in each column.
        count: rows of a window.
        columns: (n,) columns.
        channel: the one that is read.

    Returns:
        (count, n) values, in the type of the picture.
    """
    rows, width = picture.shape[:2]
    channels = picture.shape[2] if picture.ndim == 3 else 1
    start, steps = columns * channels + channel, np.arange(count)[:, None]
    if first.size and (first.min() < 0 or first.max() + count > rows):
        places = np.minimum(np.maximum(first + steps, 0), rows - 1) * (width * channels) + start
    else:
        places = (first * (width * channels) + start) + steps * (width * channels)
    # Places in the flat picture: several times as quick as an index per axis.
    return np.asarray(picture.reshape(-1).take(places))


def at_rows(picture: Picture, rows: Index, columns: Index, channel: int = 0) -> Picture:
    """Values (n,) of one channel at one row (n,) in each column (n,), taken at the edge where it lies beyond.

    Args:
        picture: (rows, columns[, channels]).
        rows, columns: (n,) places.
        channel: the one that is read.
    """
    return rows_from(picture, rows, 1, columns, channel)[0]
