"""Names for the types of arrays, and medians; shapes and units stand where they are used."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]
Float = npt.NDArray[np.float64]
Float32 = npt.NDArray[np.float32]
# Indices, and counts.
Index = npt.NDArray[np.intp]
# As OpenCV gives and takes them.
Index32 = npt.NDArray[np.int32]
Mask = npt.NDArray[np.bool_]
Flags = npt.NDArray[np.uint16]
# Small whole numbers: statuses, materials, masks as OpenCV takes them.
Codes = npt.NDArray[np.uint8]
# A picture of grey levels, (h, w).
Grey = npt.NDArray[np.uint8]
# A camera's picture, (h, w) or (h, w, 3), uint8 or uint16.
Image = npt.NDArray[Any]
# Lowest and highest value.
Interval = tuple[float, float]
# Makes the median of absolute deviations the standard deviation of a normal distribution.
SIGMA_PER_DEVIATION = 1.4826


def upper_median(values: Array) -> float:
    """Upper median of one or more values; NaN must not be among them."""
    half = values.size // 2
    return float(np.partition(values, half, axis=None)[half])


def upper_medians(rows: Array) -> Array:
    """Upper median of each row (n,) of values (n, m) without NaN."""
    half = rows.shape[1] // 2
    return np.asarray(np.partition(rows, half, axis=1)[:, half])


def robust_sigma(values: Array) -> float:
    """Standard deviation by the median absolute deviation from the median, as if the values were normal."""
    return SIGMA_PER_DEVIATION * upper_median(np.abs(values - values.dtype.type(upper_median(values))))
