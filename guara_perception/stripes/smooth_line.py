"""Evens out the positions of a stripe along its run: speckle moves each column on its own, the surface does not."""

from __future__ import annotations

from itertools import pairwise

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
        position: (..., n) rows of each of n columns, NaN where there is no stripe.
        weight: (..., n) how much each position is worth, for instance the square of the peak.

    Returns:
        (..., n) smoothed positions, NaN where they were, and (..., n) the factor by which independent noise shrinks.
    """
    known = np.isfinite(position)
    worths, values = _shifted(np.where(known, weight, 0)), _shifted(np.where(known, position, 0))
    left, right = np.s_[REACH_COLUMNS - 1 :: -1], np.s_[REACH_COLUMNS + 1 :]
    here = values[REACH_COLUMNS]
    reach = np.arange(1, REACH_COLUMNS + 1, dtype=np.float32)[:, None]
    farthest = np.maximum(np.abs(values[left] - here), np.abs(values[right] - here))
    pair = np.minimum(worths[left], worths[right])
    allowed = (farthest < STEEPEST_PX_PER_COLUMN * reach) & (pair > 0) & (worths[REACH_COLUMNS] > 0)
    for near, far in pairwise(allowed):
        far &= near
    pair *= allowed
    own = worths[REACH_COLUMNS]
    sum_of_weights = own + 2 * pair.sum(axis=0)
    sum_of_squares = own**2 + 2 * (pair**2).sum(axis=0)
    total = own * here + (pair * (values[left] + values[right])).sum(axis=0)
    safe = np.where(sum_of_weights > 0, sum_of_weights, np.float32(1))
    smooth, shrink = _lines(total / safe, position.shape), _lines(np.sqrt(sum_of_squares) / safe, position.shape)
    return np.where(known, smooth, np.float32(np.nan)), shrink


def _shifted(lines: npt.NDArray[np.floating]) -> Float32:
    """View (2 * REACH_COLUMNS + 1, m): what stands so many columns to the left, the lines themselves, to the right.

    The lines follow each other with 2 * REACH_COLUMNS columns of nothing between, across which nothing is averaged.
    """
    n = lines.shape[-1]
    length = lines.size // n * (n + 2 * REACH_COLUMNS)
    padded = np.zeros(length + 2 * REACH_COLUMNS, np.float32)
    _lines(padded[REACH_COLUMNS : length + REACH_COLUMNS], lines.shape)[...] = lines
    return np.ndarray((2 * REACH_COLUMNS + 1, length), np.float32, padded, strides=2 * padded.strides)


def _lines(row: Float32, shape: tuple[int, ...]) -> Float32:
    """View of the lines (..., n) that follow each other in a row."""
    return row.reshape(*shape[:-1], -1)[..., : shape[-1]]
