"""The best path of a stripe through all columns of a band, "no stripe here" being one of the choices."""

from __future__ import annotations

import numpy as np

from guara_perception.arrays import Float, Float32, Index, Mask

# In units of evidence: a path pays for every row that it moves by from one column to the next, but never more than
# for a jump, and for every end.
COST_PER_ROW = 0.7
COST_OF_JUMP = 6.0
COST_OF_END = 4.0


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
    both = np.ascontiguousarray(np.concatenate((evidence, evidence[:, ::-1])).transpose(1, 0, 2))
    stripe = np.empty((columns, 2 * pictures, rows), np.float32)
    none = np.zeros((columns, 2 * pictures, 1), np.float32)
    stripe[0] = both[0] - np.float32(COST_OF_END)
    best, moved = np.empty_like(stripe[0]), np.empty_like(stripe[0])
    for i in range(1, columns):
        top = stripe[i - 1].max(axis=1, keepdims=True)
        np.maximum(stripe[i - 1], np.maximum(top - COST_OF_JUMP, none[i - 1] - COST_OF_END), out=best)
        # A move of one row and one of two reach three rows to each side.
        for rows_moved in (1, 2):
            np.subtract(best, np.float32(rows_moved * COST_PER_ROW), out=moved)
            np.maximum(best[:, rows_moved:], moved[:, :-rows_moved], out=best[:, rows_moved:])
            np.maximum(best[:, :-rows_moved], moved[:, rows_moved:], out=best[:, :-rows_moved])
        np.add(best, both[i], out=stripe[i])
        np.maximum(none[i - 1], top - COST_OF_END, out=none[i])
    through = stripe[:, :pictures]
    through += stripe[::-1, pictures:]
    through -= both[:, :pictures]
    row = through.argmax(axis=2)
    score = np.take_along_axis(through, row[..., None], axis=2)[..., 0]
    without = none[:, :pictures, 0] + none[::-1, pictures:, 0]
    return row.T, (score > without).T, np.maximum(score, without)[0].astype(np.float64)
