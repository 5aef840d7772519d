"""Smoothing of a band of laser light: over three columns, and across the stripe."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

Light = npt.NDArray[Any]

# Averaging three columns before looking for the peak halves the noise of a dim stripe.
COLUMN_MEAN_PX = 3
# Three rows lose next to nothing of a thin stripe's peak; a wide stripe is smoothed to its own width.
ROW_MEAN_PX = 3
# Sigma of that mean [px].
ROW_SMOOTHING_SIGMA_PX = float(np.sqrt(2 / 3))
# Sums instead of means keep the fractions of a grey level in whole numbers.
SCALE = COLUMN_MEAN_PX * ROW_MEAN_PX


def smooth_light(light: Light) -> Light:
    """SCALE times the light (rows, columns), averaged over COLUMN_MEAN_PX columns and the ROW_MEAN_PX rows."""
    return np.asarray(cv2.boxFilter(light, -1, (COLUMN_MEAN_PX, ROW_MEAN_PX), normalize=False))


def smooth_wide(light: Light, sigma: float) -> Light:
    """The same with a Gaussian of this sigma [px] over rows."""
    taps = ROW_MEAN_PX * cv2.getGaussianKernel(2 * int(np.ceil(2 * sigma)) + 1, sigma)
    return np.asarray(cv2.sepFilter2D(light, -1, np.ones(COLUMN_MEAN_PX), taps, borderType=cv2.BORDER_REPLICATE))


def sums_of_columns(light: Light, rows: int, columns: int) -> Light:
    """Sums of COLUMN_MEAN_PX columns at every so many rows and columns: what smoothing over rows starts from."""
    some = light[::rows]
    count = (light.shape[1] - COLUMN_MEAN_PX) // columns + 1
    first, second, third = (some[:, shift : shift + count * columns : columns] for shift in range(COLUMN_MEAN_PX))
    return np.asarray(first + second + third)
