"""Smoothing of a band of laser light: over three columns, and across the stripe."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

Light = npt.NDArray[Any]

# Averaging three columns before looking for the peak halves the noise of a dim stripe.
COLUMN_MEAN_PX = 3
# Smoothing across the stripe, a Gaussian of this sigma; a wide stripe is smoothed to its own width.
ROW_TAPS = np.array([1.0, 4.0, 6.0, 4.0, 1.0])
ROW_SMOOTHING_SIGMA_PX = 1.0
# Sums instead of means keep the fractions of a grey level in whole numbers: 255 * 3 * 16 fits 16 bits.
SCALE = COLUMN_MEAN_PX * float(ROW_TAPS.sum())


def smooth_light(light: Light) -> Light:
    """SCALE times the light (rows, columns), smoothed over COLUMN_MEAN_PX columns and by ROW_TAPS over rows."""
    return _filtered(light, ROW_TAPS)


def smooth_wide(light: Light, sigma: float) -> Light:
    """The same with a Gaussian of another sigma [px] over rows."""
    taps = cv2.getGaussianKernel(2 * int(np.ceil(2 * sigma)) + 1, sigma)
    return _filtered(light, ROW_TAPS.sum() * taps)


def sums_of_columns(light: Light, rows: int, columns: int) -> Light:
    """Sums of COLUMN_MEAN_PX columns at every so many rows and columns: what smoothing over rows starts from."""
    some = light[::rows]
    count = (light.shape[1] - COLUMN_MEAN_PX) // columns + 1
    first, second, third = (some[:, shift : shift + count * columns : columns] for shift in range(COLUMN_MEAN_PX))
    return np.asarray(first + second + third)


def _filtered(light: Light, taps: npt.NDArray[np.float64]) -> Light:
    return np.asarray(cv2.sepFilter2D(light, -1, np.ones(COLUMN_MEAN_PX), taps, borderType=cv2.BORDER_REPLICATE))
