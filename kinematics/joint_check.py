"""Joints that cannot be: standing legs close chains, and a joint that reads wrong opens them.

With T_k = (R_k, t_k) the pose of the body at pause k, c_i(q) the sole of leg i in `base_link` and p the foothold on
which it stands, every reading of a standing leg says

    R_k c_i(q_k - b) + t_k - p = e,

for one foothold over all pauses in which the foot stays, b the error of the joints. A flat sole lies on its foothold
(the z of its x axis is that of the ground's slope), and an IMU says where R_k has down. Poses, footholds and slopes are
unknown: they are eliminated by least squares, and what is left of the readings is compared with what an error of each
joint would leave. With A the derivatives by the unknowns, B by a joint, r the residual, all whitened, and P the
projection off the columns of A,

    b = -(P B) . r / |P B|^2,   sigma_b = 1 / |P B|.

A joint that jumped has such an error from the newest pause on, a joint with a wrong zero in all of them. The latter
shows as far as the legs move between the pauses and the soles are flat: `JointCheck.sigmas` says of each joint how far.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from kinematics.arrays import Float
from kinematics.carried_gravity import turn_between
from kinematics.exceptions import StanceError
from kinematics.footprint import fit_support_plane, skew, transform_base_to_footprint
from kinematics.model import RobotModel
from kinematics.stance import Stance
from kinematics.state import RobotState
from kinematics.transforms import unit_vector

# Pauses over which a wrong zero is looked for, two cycles of four legs, and the fewest: one cycle.
LONGEST, SHORTEST = 9, 5
# Standing feet creep by this much between two pauses, per horizontal axis [m]: 4 % of the way of a cycle of 140 mm.
SLIP_SIGMA = 0.0015
# And sink by this much [m].
SINK_SIGMA = 0.0005
# An error is told from here on [rad], and from so many of its own standard deviations.
LEAST_ERROR, LEAST_SIGMAS = 0.045, 4.5
# Largest jump that is looked for [rad]: a foot that swings along its leg's arc looks like a larger one.
LARGEST_JUMP = 0.35
# A foot that moved by more swings of `swing_least` was lifted, where the other feet agree without it.
MOST_SWING = 1.25
# Joints that explain the readings worse by more than this chi^2 than the best are not named.
AS_LIKELY = 9.0
# The noise of a walk is learned over so many pauses: its variance is at least this share of what robot.toml states, and
# all of it where too few pauses tell.
LEAST_SCALE, LEARNED = 0.2, 36
# A zero is told where its standard deviation is at most this [rad].
LARGEST_SIGMA = 0.03
# Joints beyond their limits by more are told [rad]: less is an encoder's offset, or a nominal limit.
BEYOND_LIMIT = 0.1
# A position and a heading in `odom` that are as good as unknown [m, rad].
UNKNOWN = 10.0


@dataclass(frozen=True, slots=True)
class JointFault:
    """An error of one joint, or of one of several.

    Attributes:
        joints: names of the joints that explain the readings, the likeliest first.
        error: error of the first of them, reading minus truth [rad].
        sigma: its standard deviation [rad]; 0 for a joint beyond its limits.
        kind: "jump" (since the last pause), "offset" (in all pauses of the window) or "limit".
    """

    joints: tuple[str, ...]
    error: float
    sigma: float
    kind: str

    def __str__(self) -> str:
        """A sentence for the status."""
        names = " or ".join(self.joints)
        if self.kind == "limit":
            return f"joint {names} reads {self.error:+.2f} rad beyond its limits: check its encoder"
        size = f"{self.error:+.2f} rad (sigma {self.sigma:.3f})"
        if self.kind == "jump":
            return f"joint {names} jumped by {size} since the last pause, or its foot slipped: check its encoder"
        return f"joint {names} reads {size} wrong: check its zero"


@dataclass(frozen=True, slots=True)
class JointReport:
    """Verdict on the joints at one pause.

    Attributes:
        residual: rms of the closed chains between this pause and the last, in standard deviations; NaN where fewer than
            three feet stayed.
        faults: what cannot be; empty when all is well.
    """

    residual: float
    faults: tuple[JointFault, ...] = ()


class _Reading:
    """Legs of one pause: soles, their derivatives and covariances, x axes of flat soles, and gravity."""

    def __init__(self, robot: RobotModel, stance: Stance, state: RobotState) -> None:
        tree, self.legs = state.tree, stance.support_feet
        self.soles = state.soles_in_base(self.legs)
        self.jacobians = [state.jacobian(tree.leg(leg).sole) for leg in self.legs]
        # A foot that stays keeps its contact: of its error only the joints' part changes.
        self.covariances = [robot.noise.encoder_sigma**2 * j[:3] @ j[:3].T for j in self.jacobians]
        self.axes = [
            state.transform_to_base(tree.leg(leg).sole)[:3, 0] if len(tree.leg(leg).joints) > 3 else None
            for leg in self.legs
        ]
        self.down = None if stance.gravity_in_base is None else unit_vector(stance.gravity_in_base)

    def soles_of(self, legs: Sequence[str]) -> Float:
        return self.soles[[self.legs.index(leg) for leg in legs]]


@dataclass(frozen=True, slots=True)
class _Placed:
    """A reading, about where its body was, and the number of the foothold of each of its legs that counts."""

    reading: _Reading
    rotation: Float
    origin: Float
    footholds: Mapping[str, int]

    def then(self, reading: _Reading, stayed: Sequence[str], footholds: Mapping[str, int]) -> _Placed:
        """The reading of the next pause, by the feet that stayed, three or more."""
        now, before = reading.soles_of(stayed), self.reading.soles_of(stayed)
        turn = turn_between(now, before)
        shift = before.mean(axis=0) - turn @ now.mean(axis=0)
        return _Placed(reading, self.rotation @ turn, self.rotation @ shift + self.origin, footholds)


class _Chains:
    """Whitened least squares over some pauses, free of poses, footholds and slopes.

    Attributes:
        chi2: of what is left of the readings.
        degrees: its degrees of freedom.
    """

    def __init__(self, robot: RobotModel, pauses: Sequence[_Placed]) -> None:
        noise = robot.noise
        footholds = sorted({(m, leg) for pause in pauses for leg, m in pause.footholds.items()})
        column = {key: 6 * len(pauses) + 4 * row for row, key in enumerate(footholds)}
        first: dict[tuple[int, str], Float] = {}
        width, joints = 6 * len(pauses) + 4 * len(footholds), len(robot.joint_names)
        blocks: list[tuple[Float, Float, Float]] = []
        last: list[bool] = []
        for k, pause in enumerate(pauses):
            rotation, reading, before = pause.rotation, pause.reading, len(blocks)
            for row, leg in enumerate(reading.legs):
                if leg not in pause.footholds:
                    continue
                key = (pause.footholds[leg], leg)
                arm, jacobian, axis = rotation @ reading.soles[row], reading.jacobians[row], reading.axes[row]
                covariance = rotation @ reading.covariances[row] @ rotation.T
                covariance[[0, 1, 2], [0, 1, 2]] += SLIP_SIGMA**2, SLIP_SIGMA**2, SINK_SIGMA**2
                whiten = np.linalg.inv(np.linalg.cholesky(covariance))
                design = np.zeros((3, width))
                design[:, 6 * k : 6 * k + 6] = np.hstack([np.eye(3), -skew(arm)])
                design[:, column[key] : column[key] + 3] = -np.eye(3)
                point = arm + pause.origin
                off = point - first.setdefault(key, point)
                blocks.append((whiten @ design, -whiten @ rotation @ jacobian[:3], whiten @ off))
                if axis is not None:
                    ahead = rotation @ axis
                    # z of w x ahead is w_x ahead_y - w_y ahead_x.
                    design = np.zeros((1, width))
                    design[0, 6 * k + 3 : 6 * k + 5] = ahead[1], -ahead[0]
                    design[0, column[key] + 3] = -1.0
                    by_joint = -(rotation[2] @ np.cross(jacobian[3:].T, axis).T)[None, :]
                    sigma = math.hypot(noise.sole_pitch_sigma, noise.encoder_sigma * float(np.linalg.norm(by_joint)))
                    blocks.append((design / sigma, by_joint / sigma, ahead[2:] / sigma))
            if reading.down is not None:
                down = rotation @ reading.down
                design = np.zeros((2, width))
                design[:, 6 * k + 3 : 6 * k + 6] = -skew(down)[:2]
                blocks.append((design / noise.imu_sigma, np.zeros((2, joints)), down[:2] / noise.imu_sigma))
            last += [k == len(pauses) - 1] * sum(len(values) for *_, values in blocks[before:])
        # Where the walk begins is free, but for its tilt; slopes are those of the terrain.
        priors = np.zeros(width)
        priors[:6] = 1 / UNKNOWN
        priors[3:5] = priors[6 * len(pauses) + 3 :: 4] = 1 / noise.terrain_slope_sigma
        prior = np.diag(priors)[priors > 0]
        basis, _ = np.linalg.qr(np.vstack([*(design for design, _, _ in blocks), prior]))
        # The rows of the readings; those of the priors hold no value and no joint.
        self._basis = basis[: len(last)]
        self._by_joints = np.vstack([by_joint for _, by_joint, _ in blocks])
        self._is_last = np.array(last)[:, None]
        values = np.concatenate([value for *_, value in blocks])
        self._values = values
        left = self._basis.T @ values
        self.chi2 = float(values @ values - left @ left)
        self.degrees = max(len(values) + len(prior) - width, 1)

    @property
    def is_consistent(self) -> bool:
        """Whether noise explains what is left."""
        return self.chi2 < _most(self.degrees)

    def errors(self, *, since_last: bool) -> tuple[Float, Float]:
        """Error of each joint, taken by itself, and its standard deviation (infinite where nothing tells) [rad]."""
        design = self._by_joints * self._is_last if since_last else self._by_joints
        along = self._basis.T @ design
        information = np.sum(design**2, axis=0) - np.sum(along**2, axis=0)
        # Rounding of what the projection leaves is no information.
        told = information > 1e-9 * np.sum(self._by_joints**2, axis=0) + 1e-9
        information = np.where(told, information, 1.0)
        error = -(self._values @ design - (self._basis.T @ self._values) @ along) / information
        return np.where(told, error, 0.0), np.where(told, information**-0.5, np.inf)


class JointCheck:
    """Test of the joints of a walk, from pause to pause.

    Args:
        robot: the model; its table [stance] says how noisy the joints are.
    """

    def __init__(self, robot: RobotModel) -> None:
        self._robot = robot
        self._pauses: tuple[_Placed, ...] = ()
        self._count = 0
        self._noise: tuple[tuple[float, int], ...] = ()
        self._jump: tuple[int, JointFault] | None = None

    def reset(self) -> None:
        """Forget the walk."""
        self._pauses, self._noise, self._jump = (), (), None

    @property
    def sigmas(self) -> dict[str, float]:
        """Standard deviation with which the pauses so far tell a wrong zero, by joint [rad]; inf where they do not."""
        if not self._pauses:
            return dict.fromkeys(self._robot.joint_names, math.inf)
        _, sigma = _Chains(self._robot, self._pauses).errors(since_last=False)
        return dict(zip(self._robot.joint_names, sigma.tolist(), strict=True))

    def update(self, stance: Stance) -> JointReport:
        """Test the joints at a new pause.

        Raises:
            UnknownName, JointPositionError: the stance is not one of this robot.
        """
        state = self._robot.state(stance.joint_positions)
        reading = _Reading(self._robot, stance, state)
        faults = [
            JointFault((name,), beyond, 0.0, "limit")
            for name, beyond in state.beyond_limits.items()
            if beyond > BEYOND_LIMIT
        ]
        self._count += 1
        residual = math.nan
        stayed: tuple[str, ...] = ()
        if self._pauses:
            stayed, residual, jump = self._since_last(reading)
            if jump is not None:
                self._jump = self._count, jump
                stayed = ()
        if len(stayed) < 3:
            self._pauses = self._begin(reading)
        else:
            last = self._pauses[-1]
            footholds = {leg: last.footholds[leg] if leg in stayed else self._count for leg in reading.legs}
            self._pauses = (*self._pauses, last.then(reading, stayed, footholds))[-LONGEST:]
        if len(self._pauses) >= SHORTEST:
            faults += self._offsets(_Chains(self._robot, self._pauses))
        if self._jump is not None and self._count - self._jump[0] < SHORTEST:
            faults.append(self._jump[1])
        return JointReport(residual, tuple(faults))

    def _begin(self, reading: _Reading) -> tuple[_Placed, ...]:
        """A first pause; none where its feet are too few, or on a line, to compare the next one with."""
        try:
            plane = fit_support_plane(reading.soles)
        except StanceError:
            return ()
        up = plane.normal if reading.down is None else -reading.down
        transform = transform_base_to_footprint(reading.soles, up)
        return (_Placed(reading, transform[:3, :3], transform[:3, 3], dict.fromkeys(reading.legs, self._count)),)

    def _offsets(self, chains: _Chains) -> list[JointFault]:
        """A joint with a wrong zero; the noise is that of the readings themselves, once that error is gone."""
        found = {}
        errors, sigmas = chains.errors(since_last=False)
        for name, error, sigma in zip(self._robot.joint_names, errors.tolist(), sigmas.tolist(), strict=True):
            left = chains.chi2 - (error / sigma) ** 2
            scaled = sigma * math.sqrt(max(left / chains.degrees, LEAST_SCALE))
            if scaled < LARGEST_SIGMA and _is_error(error, scaled):
                found[name] = left, error, scaled
        fault = _likeliest(found, "offset")
        return [] if fault is None else [fault]

    def _since_last(self, reading: _Reading) -> tuple[tuple[str, ...], float, JointFault | None]:
        """Feet that stayed since the last pause, residual of their chains, and a joint that jumped."""
        last = self._pauses[-1]
        common = [leg for leg in last.reading.legs if leg in reading.legs]
        tried: list[tuple[tuple[str, ...], _Chains]] = []
        for size in range(len(common), 2, -1):
            of_size = []
            for legs in combinations(common, size):
                footholds = dict.fromkeys(legs, 0)
                before = replace(last, footholds=footholds)
                of_size.append((legs, _Chains(self._robot, (before, before.then(reading, legs, footholds)))))
            tried += of_size
            stayed, chains = min(of_size, key=lambda each: each[1].chi2)
            if chains.is_consistent:
                moved = last.then(reading, stayed, {})
                tried = [
                    each for each in tried if set(each[0]) >= set(stayed) and self._may_have_stayed(moved, each[0])
                ]
                jump = self._jumped(tried)
                if jump is None:
                    self._noise = (*self._noise, (chains.chi2, chains.degrees))[-LEARNED:]
                return stayed, math.sqrt(chains.chi2 / chains.degrees), jump
        return (), math.nan, self._jumped(tried)

    def _scale(self) -> float:
        """Share of the variance of robot.toml that the walk so far has at most, with a certainty of two sigmas."""
        chi2, degrees = (sum(of) for of in zip(*self._noise, strict=True)) if self._noise else (0.0, 0)
        return min(max(chi2 / degrees * (1.0 + 2.0 * math.sqrt(2.0 / degrees)), LEAST_SCALE), 1.0) if degrees else 1.0

    def _jumped(self, tried: Sequence[tuple[tuple[str, ...], _Chains]]) -> JointFault | None:
        """A joint whose jump explains why feet did not stay; `tried` are the sets of feet that may have stayed."""
        tree, scale = self._robot.tree, self._scale()
        found: dict[str, tuple[float, float, float]] = {}
        for legs, chains in tried:
            errors, sigmas = chains.errors(since_last=True)
            for row in (tree.joint_index(name) for leg in legs for name in tree.leg(leg).joints):
                name, error, sigma = tree.joint_names[row], float(errors[row]), float(sigmas[row])
                left = chains.chi2 - (error / sigma) ** 2
                sigma *= math.sqrt(scale)
                if _is_error(error, sigma) and abs(error) < LARGEST_JUMP and left < _most(chains.degrees):
                    found[name] = min(found.get(name, (math.inf, 0.0, 0.0)), (left, error, sigma))
        return _likeliest(found, "jump")

    def _may_have_stayed(self, now: _Placed, legs: Sequence[str]) -> bool:
        """Whether feet that did not stay moved by so little that nobody lifted them."""
        last = self._pauses[-1]
        here = now.reading.soles_of(legs) @ now.rotation.T + now.origin
        before = last.reading.soles_of(legs) @ last.rotation.T + last.origin
        most = MOST_SWING * self._robot.odometry_limits.swing_least
        return bool((np.linalg.norm(here - before, axis=1) < most).all())


def _is_error(error: float, sigma: float) -> bool:
    return abs(error) > max(LEAST_ERROR, LEAST_SIGMAS * sigma)


def _likeliest(found: Mapping[str, tuple[float, float, float]], kind: str) -> JointFault | None:
    """The fault of the joints that leave the least chi^2, of (chi^2, error, sigma) by joint."""
    if not found:
        return None
    names = sorted(found, key=lambda name: found[name])
    least, error, sigma = found[names[0]]
    return JointFault(tuple(name for name in names if found[name][0] < least + AS_LIKELY), error, sigma, kind)


def _most(degrees: int) -> float:
    """Largest chi^2 that passes for noise."""
    return degrees + 3.0 * math.sqrt(2.0 * degrees) + 6.0
