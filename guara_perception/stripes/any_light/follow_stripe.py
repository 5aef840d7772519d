"""The best path of a stripe through all columns of a band, "no stripe here" being one of the choices."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from guara_perception.arrays import Float, Float32, Index, Mask

# In units of evidence: a path pays for every row that it moves by from one column to the next, but never more than
# for a jump, and for every end.
COST_PER_ROW = np.float32(0.7)
COST_OF_JUMP = np.float32(6.0)
COST_OF_END = np.float32(4.0)
# Rows that a path may move by from one column to the next without jumping.
REACH_ROWS = 3


def follow_stripe(evidence: Float32) -> tuple[Index, Mask, Float]:
    """Follow the stripe in several pictures of its evidence at once.

    The Viterbi algorithm (Forney: The Viterbi algorithm, Proc. IEEE 61, 1973), run from both ends together: the sum
    of the best paths up to a pixel from either side is the best path through it.

    Args:
        evidence: (pictures, columns, rows) how much more each pixel looks like stripe than like none.

    Returns:
        Row per column (pictures, columns), whether the best path has a stripe there (pictures, columns), and the
        evidence of the whole path, its costs paid (pictures,).
    """
    pictures, columns, rows = evidence.shape
    both = np.empty((columns, 2 * pictures, rows), np.float32)
    both[:, :pictures] = evidence.transpose(1, 0, 2)
    both[:, pictures:] = both[::-1, :pictures]
    # Rows beyond the picture's edges, in which no path runs.
    padded = np.full((2 * pictures, rows + 2 * REACH_ROWS), -np.inf, np.float32)
    best = padded[:, REACH_ROWS:-REACH_ROWS]
    # Views of the same rows, moved by -REACH_ROWS ... REACH_ROWS.
    moves = np.moveaxis(sliding_window_view(padded, 2 * REACH_ROWS + 1, axis=1), -1, 0)
    price = -COST_PER_ROW * np.abs(np.arange(-REACH_ROWS, REACH_ROWS + 1, dtype=np.float32))[:, None, None]
    moved = np.empty(moves.shape, np.float32)
    stripe = np.empty((columns, 2 * pictures, rows), np.float32)
    none = np.zeros((columns, 2 * pictures, 1), np.float32)
    top, least = np.empty_like(none[0]), np.empty_like(none[0])
    np.subtract(both[0], COST_OF_END, out=stripe[0])
    # The fixed cost of a call counts here: memory is used again, and wrappers of numpy's functions are passed by.
    maximum, add, subtract, highest = np.maximum, np.add, np.subtract, np.maximum.reduce
    for before, now, seen, none_before, none_now in zip(
        stripe[:-1], stripe[1:], both[1:], none[:-1], none[1:], strict=True
    ):
        highest(before, axis=1, keepdims=True, out=top)
        subtract(none_before, COST_OF_END, out=least)
        subtract(top, COST_OF_JUMP, out=none_now)
        maximum(least, none_now, out=least)
        maximum(before, least, out=best)
        add(moves, price, out=moved)
        highest(moved, axis=0, out=now)
        add(now, seen, out=now)
        subtract(top, COST_OF_END, out=none_now)
        maximum(none_now, none_before, out=none_now)
    through = stripe[:, :pictures]
    through += stripe[::-1, pictures:]
    through -= both[:, :pictures]
    row = through.argmax(axis=2)
    score = np.take_along_axis(through, row[..., None], axis=2)[..., 0]
    without = none[:, :pictures, 0] + none[::-1, pictures:, 0]
    return row.T, (score > without).T, np.maximum(score, without)[0].astype(np.float64)
