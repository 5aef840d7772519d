"""Tells the feet that stayed where they were between two pauses from those that swung or slipped.

Feet that stay keep their distances to each other, however the body moves. A foot that moved changes its distances to
the others, and the others keep theirs: so the feet that stayed are the largest set whose distances all held. A swing
can keep a single distance by chance (a foot that passes another), so the line between two feet must not have turned
further than the body can turn either.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from kinematics.arrays import Float


def find_stayed_feet(
    soles_now: Float,
    covariances_now: Float,
    soles_before: Float,
    covariances_before: Float,
    *,
    slip_sigmas: float,
    turn_limit: float,
) -> list[int]:
    """Rows of the feet that stayed, in order; fewer than two rows mean that none is known to have stayed.

    Args:
        soles_now: (n, 3) sole centres at this pause, in a frame of the body [m].
        covariances_now: (n, 3, 3) covariances of `soles_now` [m^2].
        soles_before: (n, 3) the same soles at the pause before, in the same frame of the body [m].
        covariances_before: (n, 3, 3) covariances of `soles_before` [m^2].
        slip_sigmas: a distance has changed when it differs by more standard deviations than this.
        turn_limit: largest turn of the body between two pauses [rad].
    """
    count = len(soles_now)
    change = np.zeros((count, count))
    for i, j in combinations(range(count), 2):
        change[i, j] = _distance_change(
            soles_now[[i, j]],
            soles_before[[i, j]],
            (covariances_now[i] + covariances_now[j], covariances_before[i] + covariances_before[j]),
            turn_limit,
        )
    for size in range(count, 1, -1):
        held = [
            (sum(change[i, j] for i, j in combinations(rows, 2)), rows)
            for rows in combinations(range(count), size)
            if all(change[i, j] <= slip_sigmas for i, j in combinations(rows, 2))
        ]
        if held:
            return list(min(held)[1])
    return []


def _distance_change(now: Float, before: Float, covariances: tuple[Float, Float], turn_limit: float) -> float:
    """By how many standard deviations the distance of two feet changed; infinite where their line turned too far."""
    line_now, line_before = now[1] - now[0], before[1] - before[0]
    length_now, length_before = np.linalg.norm(line_now), np.linalg.norm(line_before)
    along_now, along_before = line_now / length_now, line_before / length_before
    sigma = np.sqrt(along_now @ covariances[0] @ along_now + along_before @ covariances[1] @ along_before)
    if along_now @ along_before < np.cos(turn_limit):
        return float("inf")
    return float(abs(length_now - length_before) / sigma)
