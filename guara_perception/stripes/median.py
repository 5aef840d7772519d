"""Medians, and the standard deviation that they give, without what makes numpy's median slow on small samples."""

from __future__ import annotations

import numpy as np

from guara_perception.arrays import Array

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
