"""Sums over columns and smoothing over rows of a band of laser light."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

Light = npt.NDArray[Any]

# Averaging three columns before looking for the peak halves the noise of a dim stripe.
COLUMN_MEAN_PX = 3
# Smoothing across the stripe by 1 4 6 4 1, a Gaussian of this sigma; a wide stripe is smoothed to its own width.
ROW_SMOOTHING_SIGMA_PX = 1.0
# What the smoothing multiplies by. Whole numbers keep the fractions of a grey level, and 255 * 3 * 16 fits 16 bits.
ROW_SCALE = 16
SCALE = COLUMN_MEAN_PX * ROW_SCALE
# Rows that smoothing reaches to each side.
MARGIN = 2


def sum_of_columns(light: Light) -> Light:
    """Sums of COLUMN_MEAN_PX columns: a mean in whole numbers would lose what the noise is judged by.

    Args:
        light: (rows, columns) int16 or float32, contiguous.

    Returns:
        (rows + 2 * MARGIN, columns), the first and the last row repeated MARGIN times.
    """
    rows, columns = light.shape
    padded = np.empty((rows + 2 * MARGIN, columns), light.dtype)
    total = padded[MARGIN:-MARGIN]
    # Adding along the flat picture is quickest; only what it adds across the ends of rows is set right.
    flat, source = total.reshape(-1), light.reshape(-1)
    np.add(source[:-2], source[2:], out=flat[1:-1])
    flat[1:-1] += source[1:-1]
    total[:, 0] = 2 * light[:, 0] + light[:, 1]
    total[:, -1] = 2 * light[:, -1] + light[:, -2]
    padded[:MARGIN], padded[-MARGIN:] = total[0], total[-1]
    return padded


def smooth_rows(padded: Light) -> Light:
    """Smooth along the columns by 1 4 6 4 1, unscaled.

    Args:
        padded: (rows + 2 * MARGIN, columns) as from `sum_of_columns`.

    Returns:
        (rows, columns) of the same type, ROW_SCALE times the mean.
    """
    once = padded[:-1] + padded[1:]
    twice = once[:-1] + once[1:]
    np.add(twice[:-1], twice[1:], out=once[:-2])
    return np.asarray(np.add(once[:-3], once[1:-2], out=twice[:-2]))


def smooth_wide(light: Light, sigma: float) -> Light:
    """Gaussian smoothing (rows, columns) along the columns, times ROW_SCALE."""
    taps = ROW_SCALE * cv2.getGaussianKernel(2 * int(np.ceil(2 * sigma)) + 1, sigma)
    return np.asarray(cv2.sepFilter2D(light, -1, np.ones(1), taps, borderType=cv2.BORDER_REPLICATE))
