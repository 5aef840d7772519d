"""Follows the stripe through columns that have more than one peak: dynamic programming with an explicit dropout."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Float = npt.NDArray[np.float64]
Float32 = npt.NDArray[np.float32]
Index = npt.NDArray[np.intp]

# Cost of a peak: so many times the logarithm of how much weaker it is than the strongest of its column.
WEAKNESS_COST = 2.0
# Moving between columns costs one unit per so many rows, and a jump (an edge) never more than JUMP_COST.
ROWS_PER_COST = 2.0
JUMP_COST = 4.0
# Saying that a column has no stripe although it has peaks, and entering or leaving that state.
DROPOUT_COST = 3.0
GAP_COST = 1.0


def follow(rows: Index, heights: Float32) -> tuple[npt.NDArray[np.intp], Float]:
    """Choose one peak, or none, in each of a run of neighbouring columns.

    Args:
        rows: (k, n) rows of the candidates of each column.
        heights: (k, n) their heights, 0 where a column has fewer than k.

    Returns:
        choice (n,): place of the chosen candidate, -1 for none; margin (n,): by how much the cheapest path that
        chooses otherwise in this column costs more than the best path.
    """
    k, n = rows.shape
    strongest = np.maximum(heights.max(axis=0), 1e-6)
    own = np.full((k + 1, n), np.inf)
    with np.errstate(divide="ignore"):
        own[:k] = np.where(heights > 0, -WEAKNESS_COST * np.log(heights / strongest), np.inf)
    own[k] = DROPOUT_COST
    steps = _steps(rows)
    forward = own.copy()
    for i in range(1, n):
        forward[:, i] += (forward[:, i - 1, None] + steps[i - 1]).min(axis=0)
    backward = np.zeros((k + 1, n))
    for i in range(n - 2, -1, -1):
        backward[:, i] = (steps[i] + (own[:, i + 1] + backward[:, i + 1])).min(axis=1)
    total = forward + backward
    best = total.argmin(axis=0)
    ordered = np.sort(total, axis=0)
    margin = np.where(np.isfinite(ordered[1]), ordered[1] - ordered[0], np.inf)
    return np.where(best == k, -1, best), margin


def _steps(rows: Index) -> Float:
    """Costs (n - 1, k + 1, k + 1) of going from each state of a column to each of the next; the last is the dropout."""
    k, n = rows.shape
    cost = np.full((n - 1, k + 1, k + 1), GAP_COST)
    before, after = rows.T[:-1, :, None], rows.T[1:, None, :]
    cost[:, :k, :k] = np.minimum(np.abs(before - after) / ROWS_PER_COST, JUMP_COST)
    cost[:, k, k] = 0.0
    return cost
