"""Least-squares planes z = a x + b y + c through points."""

from __future__ import annotations

import numpy as np

from guara_perception.arrays import Float

# Points nearer than this to one line [m] give no plane.
LEAST_WIDTH_M = 1e-3


def fit_plane(x: Float, y: Float, z: Float) -> tuple[float, float, float] | None:
    """Plane (a, b, c) through points (n,); None for fewer than three, or all of them (almost) on a line."""
    if z.size < 3:
        return None
    mean_x, mean_y = float(x.sum()) / z.size, float(y.sum()) / z.size
    terms = np.ones((3, z.size))
    terms[0], terms[1] = x - mean_x, y - mean_y
    solved = solve_plane(terms, z)
    if solved is None:
        return None
    a, b, c = (float(value) for value in solved)
    return a, b, c - a * mean_x - b * mean_y


def solve_plane(terms: Float, z: Float) -> Float | None:
    """Factors (3,) of `terms` (3, n) that give z (n,), by the normal equations: well conditioned about the mean.

    The terms are x and y about (almost) their mean, and ones. None for fewer than three points, or points on a line.
    """
    if len(z) < 3:
        return None
    # Products of rows: for few of them matrix products take five times as long.
    normal = np.vecdot(terms[:, None], terms)
    (xx, xy), (_, yy) = normal[:2, :2]
    smallest = 0.5 * (xx + yy - np.hypot(xx - yy, 2 * xy))
    if smallest < len(z) * LEAST_WIDTH_M**2:
        return None
    return np.asarray(np.linalg.solve(normal, np.vecdot(terms, z)))
