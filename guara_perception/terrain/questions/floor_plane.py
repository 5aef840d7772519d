"""The floor under what stands on it and beside its holes: a plane that most of the heights agree with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from guara_perception.arrays import Float
from guara_perception.plane_fit import solve_plane
from guara_perception.terrain.assessment.quantile import quantile

# With 45 % of the cells on the floor, three random cells all lie on it in at least one of 100 trials with probability
# 1 - (1 - 0.45^3)^100.
TRIALS = 100
# The floor is the plane to which this share of the heights lies nearest: boxes may cover more than half of the view.
FLOOR_SHARE = 0.35
# One over the FLOOR_SHARE quantile of |noise| in standard deviations. Boxes make the sigma that follows too large: it
# is refined.
QUANTILE_TO_SIGMA = 1 / 0.4538
# Largest number of cells, evenly distributed, to which a floor is fitted: it is off by a thirtieth of their noise.
CELLS = 2000
# About this many of them judge the trials.
JUDGES = 250
# Within three of their robust standard deviations, and at least this much, heights belong to the floor.
LEAST_TOLERANCE_M = 0.002
REFINEMENTS = 10
SEED = 2024


@dataclass(frozen=True, slots=True)
class FloorPlane:
    """A plane z = a x + b y + c in base_footprint.

    Attributes:
        a, b: slopes along x and y.
        c: height at the origin [m].
        sigma: standard deviation of the floor's heights about it [m].
    """

    a: float
    b: float
    c: float
    sigma: float

    def height_at(self, x: Float | float, y: Float | float) -> Float:
        """Height of the floor [m]."""
        return np.asarray(self.a * x + self.b * y + self.c)


def fit_floor(x: Float, y: Float, z: Float) -> FloorPlane | None:
    """Find the floor among points (n,) by least quantile of squares, then least squares over those that agree.

    Deterministic: the trials are the same every time. None with fewer than three points, or all on a line.
    """
    if z.size > CELLS:
        some = np.arange(CELLS) * z.size // CELLS
        x, y, z = x.take(some), y.take(some), z.take(some)
    if z.size < 3:
        return None
    mean_x, mean_y = float(x.mean()), float(y.mean())
    terms = np.stack((x - mean_x, y - mean_y, np.ones(z.size)))
    if solve_plane(terms, z) is None:
        return None
    plane, sigma = _best_trial(terms, z)
    residual = z - plane @ terms
    for _ in range(REFINEMENTS):
        near = np.flatnonzero(np.abs(residual) <= max(3 * sigma, LEAST_TOLERANCE_M))
        refined = solve_plane(terms.take(near, axis=1), z.take(near))
        if refined is None:
            break
        has_settled = bool(np.abs(refined - plane).max() < 1e-9)
        plane = refined
        residual = z - plane @ terms
        on_floor = residual.take(near)
        sigma = float(np.sqrt(on_floor @ on_floor / near.size))
        if has_settled:
            break
    a, b = float(plane[0]), float(plane[1])
    return FloorPlane(a, b, float(plane[2] - a * mean_x - b * mean_y), sigma)


def _best_trial(terms: Float, z: Float) -> tuple[Float, float]:
    """Factors (3,) of `terms` (3, n) to which FLOOR_SHARE of the heights (n,) lies nearest, and a first sigma."""
    triples = np.random.default_rng(SEED).integers(0, z.size, (TRIALS, 3))
    matrices = terms.T[triples]
    usable = np.abs(np.linalg.det(matrices)) > 1e-9
    trials = np.linalg.solve(matrices[usable], z[triples[usable]][..., None])[..., 0]
    judges = slice(None, None, max(z.size // JUDGES, 1))
    level = np.array([0.0, 0.0, float(quantile(z[judges], 0.5))])
    trials = np.vstack((level, trials))
    distances = np.abs(z[judges] - trials @ terms[:, judges])
    rank = int(FLOOR_SHARE * (distances.shape[1] - 1))
    misses = np.partition(distances, rank, axis=1)[:, rank]
    return trials[int(misses.argmin())], QUANTILE_TO_SIGMA * float(misses.min())
