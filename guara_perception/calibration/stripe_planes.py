"""The plane of each stripe: its own lines on the plates, steadied by the mirror model, with a covariance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from guara_perception.arrays import Float
from guara_perception.calibration.mirror_model import PARAMETERS, MirrorModel, perturbed_mirror
from guara_perception.calibration.plates import PlateLine
from guara_perception.calibration.sweep import STEP_ERROR_SIGMA, Sweep
from guara_perception.readonly import readonly

# A laser plane may wobble out of the model by at least this much: bearings and mirrors are not perfect.
WOBBLE_FLOOR = np.array([2e-5, 1e-5])  # tilt along the stripe [rad], shift [m]
FREE_WOBBLE = np.array([0.01, 0.005])
NOISE_ITERATIONS = 15
# Of a normal distribution: mean square over median square.
MEDIAN_TO_MEAN_SQUARE = 2.198
# Repeatability of the mirror from scan to scan is estimated from the lines; it is not believed below this [rad].
JITTER_FLOOR = float(np.deg2rad(0.0003))
# Scatter of one averaged point of a line [m], floor of the estimate.
SCATTER_FLOOR_M = 1e-5


@dataclass(frozen=True, slots=True)
class StripeFit:
    """Planes of all stripes in base_footprint.

    Attributes:
        indices: stripe indices, ascending.
        mirror_angles: (s,) commanded [rad].
        planes: (s, 4).
        covariance: (s, 3, 3) of (turn about the mirror axis [rad], tilt along the stripe [rad], shift [m]) for
            a new scan: the fit and the repeatability of the mirror together; for a camera that is exact.
        bases: (s, 3, 4) what one unit of each of the three changes in the plane.
        jitter: standard deviation of the laser plane's angle from scan to scan [rad].
        scatter: of one averaged point of a line [m].
        wobble: (2,) standard deviations of tilt and shift about the mirror model.
        line_residual: (lines,) mean distance of each line from its stripe's plane [m].
    """

    indices: tuple[int, ...]
    mirror_angles: Float
    planes: Float
    covariance: Float
    bases: Float
    jitter: float
    scatter: float
    wobble: Float
    line_residual: Float

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        for name in ("mirror_angles", "planes", "covariance", "bases", "wobble", "line_residual"):
            object.__setattr__(self, name, readonly(getattr(self, name)))


def fit_stripes(
    lines: Sequence[PlateLine],
    points: Sequence[Float],
    sweep: Sweep,
    nominal: MirrorModel,
    noise_of: StripeFit | None = None,
) -> StripeFit:
    """Fit one plane per stripe.

    Each plane has three freedoms about the model's plane: turn about the mirror axis (free: the stepper's own error),
    tilt along the stripe and shift (held by the model as firmly as the stripes agree with it). Each line may also be
    rotated by the mirror's jitter, which all its columns share: without it the many columns would claim too much.

    Args:
        lines: of all stripes on all plates.
        points: (n, 3) points of each line in base_footprint.
        sweep: the mirror model.
        nominal: the mirror as drawn that `sweep` was fitted from.
        noise_of: an earlier fit whose jitter, scatter and wobble are taken; None = they are estimated.
    """
    model = sweep.planes
    bases = np.array([plane_basis(plane, sweep.mirror) for plane in model])
    from_model = _model_covariance(sweep, nominal, bases)
    groups = [[i for i, line in enumerate(lines) if line.index == index] for index in sweep.indices]
    sums = [[_Line.of(points[i], model[k], bases[k]) for i in group] for k, group in enumerate(groups)]
    solver = _Solver(sums, from_model[:, 1:, 1:])
    jitter, scatter, wobble = (
        solver.estimate() if noise_of is None else (noise_of.jitter, noise_of.scatter, noise_of.wobble)
    )
    solved = solver.solve(wobble, jitter, scatter)
    planes = np.array([moved_plane(model[k], bases[k], fit.change) for k, fit in enumerate(solved)])
    for_new_scan = np.array([fit.covariance for fit in solved])
    for_new_scan[:, 0, 0] += jitter**2
    row = {index: k for k, index in enumerate(sweep.indices)}
    residual = np.empty(len(lines))
    for i, line in enumerate(lines):
        plane = planes[row[line.index]]
        residual[i] = np.mean(points[i] @ plane[:3] + plane[3])
    return StripeFit(
        indices=sweep.indices,
        mirror_angles=sweep.mirror_angles.copy(),
        planes=planes,
        covariance=for_new_scan,
        bases=bases,
        jitter=jitter,
        scatter=scatter,
        wobble=np.array(wobble),
        line_residual=residual,
    )


def plane_basis(plane: Float, mirror: MirrorModel) -> Float:
    """(3, 4): change of a plane per radian of turn about the mirror axis, radian of tilt along it, metre of shift."""
    normal, axis, point = plane[:3], mirror.axis, mirror.point
    down = np.cross(axis, normal)
    return np.array([np.append(down, -down @ point), np.append(axis, -axis @ point), [0.0, 0.0, 0.0, 1.0]])


def moved_plane(plane: Float, basis: Float, change: Float) -> Float:
    """A plane moved by (turn, tilt, shift), its normal of unit length again."""
    moved = plane + change @ basis
    return np.asarray(moved / np.linalg.norm(moved[:3]))


@dataclass(frozen=True, slots=True)
class _Line:
    """What one line says about (turn, tilt, shift), summed once: normal matrix, right side, square sum, count."""

    normal: Float
    right: Float
    square: float
    count: int

    @staticmethod
    def of(points: Float, plane: Float, basis: Float) -> _Line:
        homogeneous = np.column_stack((points, np.ones(len(points))))
        design, distance = homogeneous @ basis.T, homogeneous @ plane
        return _Line(design.T @ design, design.T @ distance, float(distance @ distance), len(points))

    def left_over(self, change: Float) -> float:
        """Sum of squared distances after a change of the plane."""
        return float(change @ self.normal @ change + 2 * change @ self.right + self.square)


@dataclass(frozen=True, slots=True)
class _Solution:
    """Change of one plane and its covariance; mean square turn of its lines and mean square left over, as expected."""

    change: Float
    covariance: Float
    turn_square: float
    scatter_square: float


@dataclass(frozen=True, slots=True)
class _Solver:
    """Lines of all stripes and the model's own covariance of tilt and shift (s, 2, 2)."""

    lines: list[list[_Line]]
    from_model: Float

    def solve(self, wobble: Float, jitter: float, scatter: float) -> list[_Solution]:
        return [
            _solve(lines, self.from_model[k] + np.diag(wobble**2), jitter, scatter)
            for k, lines in enumerate(self.lines)
        ]

    def estimate(self) -> tuple[float, float, Float]:
        """Jitter, scatter and wobble from the lines themselves, by expectation maximisation."""
        jitter, scatter = 5 * JITTER_FLOOR, 3e-5
        jitter, scatter = self.noise(WOBBLE_FLOOR, jitter, scatter)
        wobble = self.wobble(jitter, scatter)
        return *self.noise(wobble, jitter, scatter), wobble

    def noise(self, wobble: Float, jitter: float, scatter: float) -> tuple[float, float]:
        """The jitter and scatter that make the lines most likely."""
        for _ in range(NOISE_ITERATIONS):
            solved = self.solve(wobble, jitter, scatter)
            jitter = max(float(np.sqrt(np.mean([fit.turn_square for fit in solved]))), JITTER_FLOOR)
            scatter = max(float(np.sqrt(np.mean([fit.scatter_square for fit in solved]))), SCATTER_FLOOR_M)
        return jitter, scatter

    def wobble(self, jitter: float, scatter: float) -> Float:
        """How far free planes stray from the model beyond what their own noise explains."""
        solved = self.solve(FREE_WOBBLE, jitter, scatter)
        square = np.median([fit.change[1:] ** 2 for fit in solved], axis=0) * MEDIAN_TO_MEAN_SQUARE
        explained = np.median([np.diag(fit.covariance)[1:] for fit in solved], axis=0)
        return np.asarray(np.sqrt(np.maximum(square - explained, WOBBLE_FLOOR**2)))


def _solve(lines: list[_Line], prior: Float, jitter: float, scatter: float) -> _Solution:
    """Least squares of (turn, tilt, shift) and one jitter per line: the line's own turn about the mirror axis."""
    n = len(lines)
    normal = np.diag(np.concatenate(([1 / (10 * STEP_ERROR_SIGMA) ** 2, 0, 0], np.full(n, 1 / jitter**2))))
    normal[1:3, 1:3] = np.linalg.inv(prior)
    right = np.zeros(3 + n)
    for i, line in enumerate(lines):
        normal[:3, :3] += line.normal / scatter**2
        normal[:3, 3 + i] = normal[3 + i, :3] = line.normal[:, 0] / scatter**2
        normal[3 + i, 3 + i] += line.normal[0, 0] / scatter**2
        right[:3] -= line.right / scatter**2
        right[3 + i] = -line.right[0] / scatter**2
    x = np.linalg.solve(normal, right)
    covariance = np.linalg.inv(normal)
    turn_square = float(np.mean(x[3:] ** 2 + np.diag(covariance)[3:]))
    left, count = 0.0, 0
    for i, line in enumerate(lines):
        effect = np.zeros((3, 3 + n))
        effect[:, :3], effect[0, 3 + i] = np.eye(3), 1
        left += line.left_over(effect @ x) + float(np.trace(line.normal @ effect @ covariance @ effect.T))
        count += line.count
    return _Solution(np.array(x[:3]), np.array(covariance[:3, :3]), turn_square, left / count)


def _model_covariance(sweep: Sweep, nominal: MirrorModel, bases: Float) -> Float:
    """(s, 3, 3): how far the model itself may be off, as turn, tilt and shift of each stripe."""
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
