"""Order statistics (upper median, value of a rank) of arrays without NaN."""

from __future__ import annotations

import numpy as np

from guara_perception.arrays import Array
from guara_perception.stripes.kernel.library import address, kernel


def upper_median(values: Array) -> float:
    """Upper median of one or more values without NaN, rounded to float32."""
    return select(values, values.size // 2)


def select(values: Array, rank: int) -> float:
    """Value of a given rank among values without NaN, rounded to float32; the lowest value has rank 0.

    Raises:
        IndexError: there is no value of this rank.
    """
    copy = np.array(values, np.float32, order="C")
    if not 0 <= rank < copy.size:
        raise IndexError(f"rank {rank} of {copy.size} values")
    return float(kernel().select_value(address(copy), copy.size, rank))
