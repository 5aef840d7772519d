"""Evens out the positions of a stripe along its run: speckle moves each column on its own, the surface does not."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Float32 = npt.NDArray[np.float32]

# Columns to each side that are averaged with their mirror image, so that a straight line stays where it is.
REACH_COLUMNS = 3
# Between two columns the line may move by so much per column; more is a jump, which is left as it is.
STEEPEST_PX_PER_COLUMN = 0.5


def smooth_line(position: Float32, weight: Float32) -> tuple[Float32, Float32]:
    """Average each position with its neighbours to both sides.

    Neighbours enter in pairs, one from each side with the same weight: a straight line is not changed, and nothing is
    averaged across a gap or a jump.

    Args:
        position: (n,) rows, NaN where there is no stripe.
        weight: (n,) how much each position is worth, for instance the square of the peak.

    Returns:
        (n,) smoothed positions, NaN where they were, and (n,) the factor by which independent noise shrinks.
    """
    worth = np.where(np.isfinite(position), weight, 0.0).astype(np.float32)
    value = np.where(np.isfinite(position), position, 0.0).astype(np.float32)
    total, sum_of_weights, sum_of_squares = worth * value, worth.copy(), worth**2
    allowed = worth > 0
    for reach in range(1, REACH_COLUMNS + 1):
        left, right = np.zeros_like(value), np.zeros_like(value)
        pair = np.zeros_like(worth)
        left[reach:], right[:-reach] = value[:-reach], value[reach:]
        pair[reach:-reach] = np.minimum(worth[: -2 * reach], worth[2 * reach :])
        steepest = STEEPEST_PX_PER_COLUMN * reach
        close = (np.abs(left - value) < steepest) & (np.abs(right - value) < steepest)
        allowed &= (pair > 0) & close
        pair *= allowed
        total += pair * (left + right)
        sum_of_weights += 2 * pair
        sum_of_squares += 2 * pair**2
    safe = np.where(sum_of_weights > 0, sum_of_weights, 1.0)
    smooth = np.where(np.isfinite(position), total / safe, np.nan).astype(np.float32)
    return smooth, (np.sqrt(sum_of_squares) / safe).astype(np.float32)
