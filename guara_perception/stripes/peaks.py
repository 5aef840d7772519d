"""Order statistics of numbers without NaN, and what is made of them."""

from __future__ import annotations

import numpy as np

from guara_perception.arrays import Array
from guara_perception.stripes.kernel.library import address, kernel

# Makes the median of absolute deviations the standard deviation of a normal distribution.
SIGMA_PER_DEVIATION = 1.4826


def upper_median(values: Array) -> float:
    """Upper median of one or more values, as float32; NaN must not be among them."""
    return select(values, values.size // 2)


def select(values: Array, rank: int) -> float:
    """Value of this rank among values without NaN, as float32; the lowest has rank 0."""
    copy = np.array(values, np.float32, order="C")
    if not 0 <= rank < copy.size:
        raise IndexError(f"rank {rank} of {copy.size} values")
    return float(kernel().select_value(address(copy), copy.size, rank))


def upper_medians(rows: Array) -> Array:
    """Upper median of each row (n,) of values (n, m) without NaN."""
    half = rows.shape[1] // 2
    return np.asarray(np.partition(rows, half, axis=1)[:, half])


def robust_sigma(values: Array) -> float:
    """Standard deviation by the median absolute deviation from the median, as if the values were normal."""
    return SIGMA_PER_DEVIATION * upper_median(np.abs(values - values.dtype.type(upper_median(values))))
