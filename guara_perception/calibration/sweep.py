"""Joint fit of the mirror model to the lines of all stripes on all plates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from guara_perception.arrays import Float
from guara_perception.calibration.calibration import CameraModel, to_floor
from guara_perception.calibration.mirror_model import PARAMETERS, MirrorModel, perturbed_mirror
from guara_perception.calibration.plates import PlateLine
from kinematics.arrays import FrozenArrays

# Prior standard deviation of the position error of the mirror's stepper at one stripe [rad].
STEP_ERROR_SIGMA = float(np.deg2rad(0.02))
# Assumed scatter of one point of a line, which is an average over neighbouring columns.
POINT_SIGMA_M = 5e-5
ROBUST_SIGMAS = 3.0
ITERATIONS = 25
CONVERGED_SIGMAS = 1e-2
STEP_NUDGE = 1e-7


@dataclass(frozen=True, slots=True)
class Sweep(FrozenArrays):
    """Mirror model in base_footprint, and the angle error of each stripe.

    Attributes:
        mirror: fitted model.
        parameters: (9,) fitted deviations from the nominal mirror, in the order of PARAMETERS.
        covariance: (9, 9) covariance of `parameters`.
        indices: stripe indices, ascending.
        mirror_angles: (s,) commanded mirror angles [rad].
        step_errors: (s,) estimated minus commanded mirror angle [rad].
    """

    mirror: MirrorModel
    parameters: Float
    covariance: Float
    indices: tuple[int, ...]
    mirror_angles: Float
    step_errors: Float

    @property
    def planes(self) -> Float:
        """Planes (s, 4) of the model in base_footprint at the corrected angle of each stripe."""
        return self.mirror.planes(self.mirror_angles + self.step_errors)


def line_points(camera: CameraModel, transform_camera_to_footprint: Float, line: PlateLine) -> Float:
    """Points (n, 3) of a line on its plate, in base_footprint [m]."""
    floor = to_floor(camera, transform_camera_to_footprint, line.pixels, line.height)
    return np.column_stack((floor, np.full(len(floor), line.height)))


def fit_sweep(
    lines: Sequence[PlateLine], points: Sequence[Float], nominal: MirrorModel, start: Sweep | None = None
) -> Sweep:
    """Fit mirror parameters and one angle error per stripe, robustly, with the nominal mirror as a weak prior.

    Args:
        lines: lines of all stripes on all plates.
        points: (n, 3) points of each line in base_footprint [m].
        nominal: the nominal mirror in base_footprint.
        start: similar fit of the same stripes, used as initial value; None = start from the nominal mirror.
    """
    angle_of = {line.index: line.mirror_angle for line in lines}
    indices = tuple(sorted(angle_of))
    angles = np.array([angle_of[index] for index in indices])
    stripe = np.concatenate([np.full(len(p), indices.index(line.index)) for line, p in zip(lines, points, strict=True)])
    share = np.concatenate([np.full(len(p), 1 / np.sqrt(len(p) / 10)) for p in points])
    homogeneous = np.column_stack((np.concatenate(points), np.ones(len(stripe))))
    prior = np.array(list(PARAMETERS.values()))
    n, s = len(prior), len(indices)

    def distance(x: Float) -> Float:
        planes = perturbed_mirror(nominal, x[:n]).planes(angles + x[n:])
        return np.asarray((homogeneous * planes[stripe]).sum(axis=1))

    x = np.zeros(n + s) if start is None else np.concatenate((start.parameters, start.step_errors))
    precision = np.concatenate((1 / prior**2, np.full(s, 1 / STEP_ERROR_SIGMA**2)))
    nudge = 1e-4 * prior
    for _ in range(ITERATIONS):
        residual = distance(x)
        weight = share / POINT_SIGMA_M * (1 + (residual / POINT_SIGMA_M / ROBUST_SIGMAS) ** 2) ** -0.25
        shared = np.empty((len(residual), n))
        for i in range(n):
            moved = x.copy()
            moved[i] += nudge[i]
            shared[:, i] = (distance(moved) - residual) * weight / nudge[i]
        # Each angle error affects only its own stripe. One evaluation therefore gives all these columns of the
        # Jacobian, and their part of the normal equations consists of sums by stripe.
        moved = x.copy()
        moved[n:] += STEP_NUDGE
        own = (distance(moved) - residual) * weight / STEP_NUDGE
        normal = np.diag(precision)
        normal[:n, :n] += shared.T @ shared
        normal[np.arange(n, n + s), np.arange(n, n + s)] += np.bincount(stripe, own**2, s)
        for i in range(n):
            normal[i, n:] = normal[n:, i] = np.bincount(stripe, shared[:, i] * own, s)
        right = -precision * x
        right[:n] -= shared.T @ (residual * weight)
        right[n:] -= np.bincount(stripe, own * residual * weight, s)
        update = np.linalg.solve(normal, right)
        x = x + update
        if float(np.abs(update * np.sqrt(np.diag(normal))).max()) < CONVERGED_SIGMAS:
            break
    return Sweep(
        mirror=perturbed_mirror(nominal, x[:n]),
        parameters=x[:n],
        covariance=np.asarray(np.linalg.inv(normal)[:n, :n], dtype=np.float64),
        indices=indices,
        mirror_angles=angles,
        step_errors=x[n:],
    )
