"""Names for the types of arrays, read-only arrays, and medians; shapes and units stand where they are used."""

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


def readonly(array: Array) -> Array:
    """The same values in an array that cannot be written, not even through another array on the same memory.

    An array whose memory is read-only already is returned as it is. Any other is copied, so that the caller's array
    stays writable.
    """
    if _is_frozen(array):
        return array
    copy = np.array(array)
    copy.setflags(write=False)
    return copy


def _is_frozen(array: Array) -> bool:
    """Whether the array and everything that it is a view of are read-only."""
    memory: Any = array
    while isinstance(memory, np.ndarray):
        if memory.flags.writeable:
            return False
        memory = memory.base
    return memory is None or isinstance(memory, bytes)


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
