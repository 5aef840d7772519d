"""The middle of some values, without what makes numpy's median slow on small samples."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

# Makes the median of absolute deviations the standard deviation of a normal distribution.
SIGMA_PER_DEVIATION = 1.4826


def middle(values: npt.NDArray[Any]) -> float:
    """Upper median of one or more values; NaN must not be among them."""
    half = values.size // 2
    return float(np.partition(values, half, axis=None)[half])


def middles(rows: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Upper median of each row (n,) of values (n, m) without NaN."""
    half = rows.shape[1] // 2
    return np.asarray(np.partition(rows, half, axis=1)[:, half])


def spread(values: npt.NDArray[Any]) -> float:
    """Robust standard deviation: median absolute deviation from the middle, scaled."""
    return SIGMA_PER_DEVIATION * middle(np.abs(values - values.dtype.type(middle(values))))
