"""Planes of the stripes and their covariance, fitted to the lines on plates with the mirror model as a prior."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from guara_perception.arrays import Float
from guara_perception.calibration.mirror_model import PARAMETERS, MirrorModel, perturbed_mirror
from guara_perception.calibration.plates import PlateLine
from guara_perception.calibration.sweep import STEP_ERROR_SIGMA, Sweep
from kinematics.arrays import FrozenArrays

# Lower bounds of the estimated deviation of laser planes from the mirror model; bearings and mirrors are imperfect.
WOBBLE_FLOOR = np.array([2e-5, 1e-5])  # tilt along the stripe [rad], shift [m]
FREE_WOBBLE = np.array([0.01, 0.005])
NOISE_ITERATIONS = 15
# Ratio of mean square to median square of a normal distribution.
MEDIAN_TO_MEAN_SQUARE = 2.198
# Lower bound of the estimated jitter of the laser plane's angle from scan to scan [rad].
JITTER_FLOOR = float(np.deg2rad(0.0003))
# Lower bound of the estimated scatter of one averaged point of a line [m].
SCATTER_FLOOR_M = 1e-5


@dataclass(frozen=True, slots=True)
class StripeFit(FrozenArrays):
    """Planes of all stripes in base_footprint.

    Attributes:
        indices: stripe indices, ascending.
        mirror_angles: (s,) commanded mirror angles [rad].
        planes: (s, 4) planes n . X + d = 0.
        covariance: (s, 3, 3) covariance, in a new scan, of the plane's turn about the mirror axis [rad], tilt along the
            stripe [rad] and shift [m]. It includes errors of the fit and repeatability of the mirror, but not errors of
            the camera.
        bases: (s, 3, 4) derivatives of the plane with respect to turn, tilt and shift.
        jitter: standard deviation of the laser plane's angle from scan to scan [rad].
        scatter: scatter of one averaged point of a line [m].
        wobble: (2,) standard deviations of tilt [rad] and shift [m] about the mirror model.
    """

    indices: tuple[int, ...]
    mirror_angles: Float
    planes: Float
    covariance: Float
    bases: Float
    jitter: float
    scatter: float
    wobble: Float


def fit_stripes(
    lines: Sequence[PlateLine],
    points: Sequence[Float],
    sweep: Sweep,
    nominal: MirrorModel,
    noise_of: StripeFit | None = None,
) -> StripeFit:
    """Fit one plane per stripe.

    Each plane deviates from the model's plane in three degrees of freedom: turn about the mirror axis, tilt along the
    stripe, and shift. The turn has a wide prior, because it contains the rest of the stepper's error. The priors of
    tilt and shift are estimated from the agreement of the stripes with the model. Each line is also rotated by the
    jitter of the mirror, an error common to all columns of the line. If the jitter were neglected, the sigmas would be
    too small.

    Args:
        lines: lines of all stripes on all plates.
        points: (n, 3) points of each line in base_footprint [m].
        sweep: fitted mirror model.
        nominal: nominal mirror, from which `sweep.parameters` are the deviations.
        noise_of: earlier fit whose jitter, scatter and wobble are used; None = estimate them.
    """
    model = sweep.planes
    bases = np.array([plane_basis(plane, sweep.mirror) for plane in model])
    from_model = _model_covariance(sweep, nominal, bases)
    of_stripes = [[points[i] for i, line in enumerate(lines) if line.index == index] for index in sweep.indices]
    solver = _Solver(_Lines.of(of_stripes, model, bases), from_model[:, 1:, 1:])
    noise = solver.estimate() if noise_of is None else (noise_of.jitter, noise_of.scatter, noise_of.wobble)
    jitter, scatter, wobble = noise
    changes, covariance, _, _ = solver.solve(wobble, jitter, scatter)
    planes = np.array([moved_plane(*each) for each in zip(model, bases, changes, strict=True)])
    for_new_scan = np.array(covariance)
    for_new_scan[:, 0, 0] += jitter**2
    return StripeFit(
        indices=sweep.indices,
        mirror_angles=sweep.mirror_angles,
        planes=planes,
        covariance=for_new_scan,
        bases=bases,
        jitter=jitter,
        scatter=scatter,
        wobble=wobble,
    )


def plane_basis(plane: Float, mirror: MirrorModel) -> Float:
    """Derivatives (3, 4) of a plane with respect to turn about the mirror axis [rad], tilt [rad] and shift [m]."""
    normal, axis, point = plane[:3], mirror.axis, mirror.point
    down = np.cross(axis, normal)
    return np.array([np.append(down, -down @ point), np.append(axis, -axis @ point), [0.0, 0.0, 0.0, 1.0]])


def moved_plane(plane: Float, basis: Float, change: Float) -> Float:
    """Change a plane (4,) by (turn, tilt, shift), and normalise its normal."""
    moved = plane + change @ basis
    return np.asarray(moved / np.linalg.norm(moved[:3]))


@dataclass(frozen=True, slots=True)
class _Lines:
    """Least-squares sums for (turn, tilt, shift) of the lines of s stripes, up to m lines per stripe.

    The entries of a stripe with fewer than m lines end in zeros.

    Attributes:
        normal: (s, m, 3, 3) normal matrices.
        right: (s, m, 3) right-hand sides.
        square: (s, m) sums of squared distances.
        count: (s, m) numbers of points.
    """

    normal: Float
    right: Float
    square: Float
    count: Float

    @staticmethod
    def of(points: list[list[Float]], planes: Float, bases: Float) -> _Lines:
        shape = (len(points), max(map(len, points), default=0))
        normal, right = np.zeros((*shape, 3, 3)), np.zeros((*shape, 3))
        square, count = np.zeros(shape), np.zeros(shape)
        for k, of_stripe in enumerate(points):
            for i, line in enumerate(of_stripe):
                design = line @ bases[k, :, :3].T + bases[k, :, 3]
                distance = line @ planes[k, :3] + planes[k, 3]
                normal[k, i], right[k, i] = design.T @ design, design.T @ distance
                square[k, i], count[k, i] = distance @ distance, len(line)
        return _Lines(normal, right, square, count)


@dataclass(frozen=True, slots=True)
class _Solver:
    """Least-squares solver for the planes of all stripes, and estimator of their noise.

    Attributes:
        lines: sums over the lines of all stripes.
        from_model: (s, 2, 2) covariance of tilt and shift due to the errors of the mirror model.
    """

    lines: _Lines
    from_model: Float

    def solve(self, wobble: Float, jitter: float, scatter: float) -> tuple[Float, Float, Float, Float]:
        """Solve for (turn, tilt, shift) of each stripe and one additional turn per line, the jitter of the mirror.

        Returns:
            Deviations (s, 3) from the model's planes (turn, tilt, shift) and their covariance (s, 3, 3); expected mean
            squares (s,) of the lines' individual turns [rad^2] and of the distances of the points [m^2].
        """
        lines, weight = self.lines, scatter**-2
        stripes, most = lines.count.shape
        own = 3 + np.arange(most)
        normal = np.zeros((stripes, 3 + most, 3 + most))
        normal[:, 0, 0] = 1 / (10 * STEP_ERROR_SIGMA) ** 2
        normal[:, 1:3, 1:3] = np.linalg.inv(self.from_model + np.diag(wobble**2))
        normal[:, :3, :3] += weight * lines.normal.sum(axis=1)
        normal[:, own, own] = 1 / jitter**2 + weight * lines.normal[:, :, 0, 0]
        normal[:, own, :3] = weight * lines.normal[:, :, :, 0]
        normal[:, :3, 3:] = normal[:, 3:, :3].transpose(0, 2, 1)
        right = -weight * np.concatenate((lines.right.sum(axis=1), lines.right[:, :, 0]), axis=1)
        covariance: Float = np.asarray(np.linalg.inv(normal), dtype=np.float64)
        x: Float = np.asarray(np.linalg.solve(normal, right[..., None])[..., 0], dtype=np.float64)

        # The deviation of a line is that of its stripe's plane plus the line's own turn.
        change = np.repeat(x[:, None, :3], most, axis=1)
        change[..., 0] += x[:, 3:]
        of_line = np.repeat(covariance[:, None, :3, :3], most, axis=1)
        of_line[..., 0, :] += covariance[:, 3:, :3]
        of_line[..., :, 0] += covariance[:, 3:, :3]
        of_line[..., 0, 0] += covariance[:, own, own]
        left = (
            np.einsum("smi,smij,smj->sm", change, lines.normal, change)
            + 2 * np.einsum("smi,smi->sm", change, lines.right)
            + lines.square
            + np.einsum("smij,smij->sm", lines.normal, of_line)
        )
        turn = np.where(lines.count > 0, x[:, 3:] ** 2 + covariance[:, own, own], 0.0)
        turn_square = turn.sum(axis=1) / np.count_nonzero(lines.count, axis=1)
        return x[:, :3], covariance[:, :3, :3], turn_square, left.sum(axis=1) / lines.count.sum(axis=1)

    def estimate(self) -> tuple[float, float, Float]:
        """Estimate jitter and scatter by expectation maximisation, and wobble from loosely constrained planes."""
        jitter, scatter = 5 * JITTER_FLOOR, 3e-5
        jitter, scatter = self.noise(WOBBLE_FLOOR, jitter, scatter)
        wobble = self.wobble(jitter, scatter)
        return *self.noise(wobble, jitter, scatter), wobble

    def noise(self, wobble: Float, jitter: float, scatter: float) -> tuple[float, float]:
        """Maximum likelihood estimates of jitter [rad] and scatter [m], not below their lower bounds."""
        for _ in range(NOISE_ITERATIONS):
            _, _, turn_square, scatter_square = self.solve(wobble, jitter, scatter)
            jitter = max(float(np.sqrt(np.mean(turn_square))), JITTER_FLOOR)
            scatter = max(float(np.sqrt(np.mean(scatter_square))), SCATTER_FLOOR_M)
        return jitter, scatter

    def wobble(self, jitter: float, scatter: float) -> Float:
        """Standard deviations (2,) of tilt and shift of loosely constrained planes about the model, without noise."""
        change, covariance, _, _ = self.solve(FREE_WOBBLE, jitter, scatter)
        square = np.median(change[:, 1:] ** 2, axis=0) * MEDIAN_TO_MEAN_SQUARE
        explained = np.median(np.diagonal(covariance, axis1=1, axis2=2)[:, 1:], axis=0)
        return np.asarray(np.sqrt(np.maximum(square - explained, WOBBLE_FLOOR**2)))


def _model_covariance(sweep: Sweep, nominal: MirrorModel, bases: Float) -> Float:
    """Covariance (s, 3, 3) of turn, tilt and shift of each stripe's model plane, from that of the model parameters."""
    angles = sweep.mirror_angles + sweep.step_errors
    prior = np.array(list(PARAMETERS.values()))
    derivative = np.empty((len(angles), 4, len(prior)))
    for i, scale in enumerate(prior):
        change = np.zeros(len(prior))
        change[i] = 1e-4 * scale
        upper = perturbed_mirror(nominal, sweep.parameters + change).planes(angles)
        lower = perturbed_mirror(nominal, sweep.parameters - change).planes(angles)
        derivative[:, :, i] = (upper - lower) / (2 * change[i])
    result = np.empty((len(angles), 3, 3))
    for k, basis in enumerate(bases):
        jacobian = np.linalg.pinv(basis.T) @ derivative[k]
        result[k] = jacobian @ sweep.covariance @ jacobian.T
    return result
