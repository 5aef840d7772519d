"""Joint consistency check: standing legs form closed kinematic chains, which a wrong joint reading opens.

With T_k = (R_k, t_k) the pose of the body at pause k, c_i(q) the sole of leg i in `base_link`, p its foothold and b the
errors of the joints, every reading of a standing leg satisfies

    R_k c_i(q_k - b) + t_k - p = e,

where e is noise and p is the same in all pauses in which the foot stays. A flat sole also measures the slope of its
foothold, as the z component of its x axis in the world. An IMU gives the vertical of R_k. Ground of known heights gives
differences of p_z between footholds. Poses, footholds and slopes are unknown and eliminated by least squares. The
residual is then compared with the residual that an error of each joint alone would cause. With A and B the Jacobians
with respect to the unknowns and to one joint, r the residual, all whitened, and P the projection onto the orthogonal
complement of the range of A, the error of that joint is

    b = -(P B) . r / |P B|^2,   sigma_b = 1 / |P B|.

A joint that jumped has such an error in the newest pause only; a joint with a wrong zero has one in all pauses. A wrong
zero is observable only if the legs move between pauses, or on known ground; flat soles reduce its sigma
(`JointCheck.sigmas`).
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
from kinematics.transforms import unit_vector
from kinematics.tree import RobotState

# Longest and shortest window in which wrong zeros are searched for [pauses]: two cycles of four steps, and one cycle.
# A jump is reported at SHORTEST pauses in a row.
LONGEST, SHORTEST = 9, 5
# Sigma of the creep of a standing foot between two pauses, per horizontal axis [m]: 4 % of the 35 mm by which the body
# moves in one of the four steps of a cycle.
SLIP_SIGMA = 0.0015
# Sigma of the sinkage of a standing foot between two pauses [m].
SINK_SIGMA = 0.0005
# A jump or wrong zero is reported only if it exceeds LEAST_ERROR [rad] and LEAST_SIGMAS standard deviations. A wrong
# zero is also reported if it exceeds LEAST_ERROR and STATED_SIGMAS. These and the following errors and sigmas are those
# of revolute joints; for prismatic ones, they are multiplied by `tree.joint_scales`.
LEAST_ERROR, LEAST_SIGMAS = 0.045, 4.5
# Limit for a wrong zero in standard deviations by the noise stated in robot.toml; noise exceeds it once in 10,000
# tests. For a wrong zero, LEAST_SIGMAS refers to the noise estimated from the window and is larger, because over one
# cycle that estimate is uncertain by a sixth.
STATED_SIGMAS = 3.9
# Jumps of this size or more are not reported [rad]: a foot that swings along the arc of its leg looks like one. A
# zero error below its reporting threshold is named as an alternative only if it is smaller than this.
LARGEST_JUMP = 0.35
# A foot that moved by this multiple of `swing_least` or more was lifted, if the other feet are consistent without it.
MOST_SWING = 1.25
# Joints whose chi^2 exceeds the smallest one by this much or more are not named.
AS_LIKELY = 9.0
# The noise variance of a walk is estimated over the last LEARNED pauses at which noise explained the residuals and no
# joint jumped. Every estimate of the noise variance, also that of a window, is at least LEAST_SCALE times the variance
# stated in robot.toml.
LEAST_SCALE, LEARNED = 0.2, 36
# A wrong zero is reported only if its sigma, by the noise of the window or of robot.toml, is below this [rad].
LARGEST_SIGMA = 0.03
# Joints beyond their limits by more than this are reported [rad]; smaller excesses are attributed to encoder offsets or
# to nominal limits.
BEYOND_LIMIT = 0.1
# Ground of known heights, such as a floor that is declared level: sigmas of its tilt, per axis [rad], and of its relief
# from foot to foot [m].
LEVEL_SIGMA, RELIEF_SIGMA = 0.01, 0.0015
# Prior sigma of the position and heading of the first pose in a window [m, rad]: practically free.
UNKNOWN = 10.0


@dataclass(frozen=True, slots=True)
class JointFault:
    """Error of one joint; several joints are named if an error of any of them explains the readings about equally well.

    Attributes:
        joints: their names, the likeliest first.
        error: error of the first joint, reading minus truth [`unit`]; for kind "limit", distance beyond its limits.
        sigma: standard deviation of the error [`unit`]; 0 for kind "limit".
        kind: "jump" (between two pauses), "offset" (in all pauses of the window) or "limit".
        unit: "rad", or "m" if the first joint is prismatic.
    """

    joints: tuple[str, ...]
    error: float
    sigma: float
    kind: str
    unit: str = "rad"

    def __str__(self) -> str:
        """Describe the fault in one line."""
        names, digits = " or ".join(self.joints), 3 if self.unit == "m" else 2
        if self.kind == "limit":
            return f"joint {names} is {self.error:.{digits}f} {self.unit} beyond its limits: check its encoder"
        size = f"{self.error:+.{digits}f} {self.unit} (sigma {self.sigma:.3f})"
        if self.kind == "jump":
            return f"joint {names} jumped by {size} between two pauses, or its foot slipped: check its encoder"
        return f"joint {names} has a zero error of {size}: check its zero"


@dataclass(frozen=True, slots=True)
class JointReport:
    """Verdict on the joints at one pause.

    Attributes:
        residual: rms residual of the closed chains between this pause and the last, in standard deviations; NaN if
            fewer than three feet stayed or there is no earlier pause to compare with.
        faults: faults found; a jump is repeated in the next four reports, unless a newer jump replaces it.
    """

    residual: float
    faults: tuple[JointFault, ...] = ()


class _Reading:
    """Standing legs of one pause: soles, Jacobians, x axes of flat soles, and the direction of gravity."""

    def __init__(self, stance: Stance, state: RobotState) -> None:
        tree, self.legs = state.tree, stance.support_feet
        self.soles = state.soles_in_base(self.legs)
        self.jacobians = [state.noise_jacobian(tree.leg(leg).sole) for leg in self.legs]
        self.axes = [
            state.transform_to_base(tree.leg(leg).sole)[:3, 0] if len(tree.leg(leg).joints) > 3 else None
            for leg in self.legs
        ]
        self.down = None if stance.gravity_in_base is None else unit_vector(stance.gravity_in_base)

    def soles_of(self, legs: Sequence[str]) -> Float:
        return self.soles[[self.legs.index(leg) for leg in legs]]


@dataclass(frozen=True, slots=True)
class _Placed:
    """Reading with an approximate pose of the body, and a foothold number for each leg in use."""

    reading: _Reading
    rotation: Float
    origin: Float
    footholds: Mapping[str, int]

    def then(self, reading: _Reading, stayed: Sequence[str], footholds: Mapping[str, int]) -> _Placed:
        """Place the reading of the next pause relative to this one, by three or more feet that stayed."""
        now, before = reading.soles_of(stayed), self.reading.soles_of(stayed)
        turn = turn_between(now, before)
        shift = before.mean(axis=0) - turn @ now.mean(axis=0)
        return _Placed(reading, self.rotation @ turn, self.rotation @ shift + self.origin, footholds)


# Foothold number and leg -> height of the ground there and its standard deviation [m].
_Ground = dict[tuple[int, str], tuple[float, float]]


class _Chains:
    """Whitened least squares over some pauses, with poses, footholds and slopes eliminated.

    Attributes:
        chi2: chi^2 of the residuals.
        degrees: degrees of freedom of the residuals; 0 for a single pause of three point feet without an IMU.
    """

    def __init__(self, robot: RobotModel, pauses: Sequence[_Placed], ground: _Ground | None = None) -> None:
        noise, ground = robot.noise, ground or {}
        footholds = sorted({(m, leg) for pause in pauses for leg, m in pause.footholds.items()})
        column = {key: 6 * len(pauses) + 4 * row for row, key in enumerate(footholds)}
        first: dict[tuple[int, str], Float] = {}
        grounded = [key for key in footholds if key in ground]
        width, joints = 6 * len(pauses) + 4 * len(footholds) + (3 if grounded else 0), len(robot.joint_names)
        blocks: list[tuple[Float, Float, Float]] = []
        last: list[bool] = []
        for k, pause in enumerate(pauses):
            rotation, reading, before = pause.rotation, pause.reading, len(blocks)
            for row, leg in enumerate(reading.legs):
                if leg not in pause.footholds:
                    continue
                key = (pause.footholds[leg], leg)
                arm, jacobian, axis = rotation @ reading.soles[row], reading.jacobians[row], reading.axes[row]
                point = arm + pause.origin
                off, by_joint = point - first.setdefault(key, point), -rotation @ jacobian[:3]
                variances = [SLIP_SIGMA**2, SLIP_SIGMA**2, SINK_SIGMA**2, noise.sole_pitch_sigma**2]
                design = np.zeros((4, width))
                design[:3, 6 * k : 6 * k + 6] = np.hstack([np.eye(3), -skew(arm)])
                design[:3, column[key] : column[key] + 3] = -np.eye(3)
                if axis is not None:
                    ahead = rotation @ axis
                    # The z component of cross(w, ahead) is w_x ahead_y - w_y ahead_x.
                    design[3, 6 * k + 3 : 6 * k + 5] = ahead[1], -ahead[0]
                    design[3, column[key] + 3] = -1.0
                    by_joint = np.vstack([by_joint, -rotation[2] @ np.cross(jacobian[3:].T, axis).T])
                    off = np.append(off, ahead[2])
                # Noise of the joints moves a sole and turns it. A foot that stays keeps its contact point, so the
                # contact noise does not vary between pauses.
                rows = len(off)
                covariance = noise.encoder_sigma**2 * by_joint @ by_joint.T + np.diag(variances[:rows])
                whiten = np.linalg.inv(np.linalg.cholesky(covariance))
                blocks.append((whiten @ design[:rows], whiten @ by_joint, whiten @ off))
            if reading.down is not None:
                down = rotation @ reading.down
                design = np.zeros((2, width))
                design[:, 6 * k + 3 : 6 * k + 6] = -skew(down)[:2]
                blocks.append((design / noise.imu_sigma, np.zeros((2, joints)), down[:2] / noise.imu_sigma))
            last += [k == len(pauses) - 1] * sum(len(values) for *_, values in blocks[before:])
        for key in grounded:
            height, sigma = ground[key]
            x, y, z = first[key]
            design = np.zeros((1, width))
            design[0, [column[key] + 2, -3, -2, -1]] = 1.0, -x, -y, -1.0
            blocks.append((design / sigma, np.zeros((1, joints)), np.array([z - height]) / sigma))
        last += [False] * len(grounded)
        # The first pose is free except for its tilt, which has the same prior as the slopes of the footholds. Known
        # ground is free in height, but not in tilt.
        priors = np.zeros(width)
        priors[:6] = 1 / UNKNOWN
        priors[3:5] = priors[[at + 3 for at in column.values()]] = 1 / noise.terrain_slope_sigma
        if grounded:
            priors[-3:] = 1 / LEVEL_SIGMA, 1 / LEVEL_SIGMA, 1 / UNKNOWN
        prior = np.diag(priors)[priors > 0]
        basis, _ = np.linalg.qr(np.vstack([*(design for design, _, _ in blocks), prior]))
        # Rows of the readings only: the priors contribute neither residuals nor joint derivatives.
        self._basis = basis[: len(last)]
        self._by_joints = np.vstack([by_joint for _, by_joint, _ in blocks])
        self._is_last = np.array(last)[:, None]
        self._values = values = np.concatenate([value for *_, value in blocks])
        left = self._basis.T @ values
        self.chi2 = float(values @ values - left @ left)
        self.degrees = len(values) + len(prior) - width

    @property
    def is_consistent(self) -> bool:
        """True if noise explains the residuals."""
        return self.chi2 < _most(self.degrees)

    def errors(self, *, since_last: bool) -> tuple[Float, Float]:
        """Error of each joint if it alone is wrong, and its standard deviation, infinite if unobservable [rad].

        With `since_last`, the joint is wrong in the last pause only; otherwise in all.
        """
        design = self._by_joints * self._is_last if since_last else self._by_joints
        along = self._basis.T @ design
        information = np.sum(design**2, axis=0) - np.sum(along**2, axis=0)
        # Rounding error of the projection is not information.
        observable = information > 1e-9 * np.sum(self._by_joints**2, axis=0) + 1e-9
        information = np.where(observable, information, 1.0)
        error = -(self._values @ design - (self._basis.T @ self._values) @ along) / information
        return np.where(observable, error, 0.0), np.where(observable, information**-0.5, np.inf)


class JointCheck:
    """Consistency check of the joints during a walk, updated at every pause.

    Args:
        robot: the model; its table [stance] gives the noise of the joints.
    """

    def __init__(self, robot: RobotModel) -> None:
        self._robot = robot
        self._pauses: tuple[_Placed, ...] = ()
        self._count = 0
        self._noise: tuple[tuple[float, int], ...] = ()
        self._jump: tuple[int, JointFault] | None = None
        self._ground: _Ground = {}

    def reset(self) -> None:
        """Return to the state before the first pause."""
        self._pauses, self._noise, self._jump, self._ground = (), (), None, {}

    @property
    def sigmas(self) -> dict[str, float]:
        """Joint name -> sigma of its zero error in the current window [rad], if prismatic [m]; inf if unobservable."""
        if not self._pauses:
            return dict.fromkeys(self._robot.joint_names, math.inf)
        _, sigma = self._window.errors(since_last=False)
        return dict(zip(self._robot.joint_names, (sigma * self._robot.tree.joint_scales).tolist(), strict=True))

    @property
    def bars(self) -> dict[str, float]:
        """Joint name -> smallest zero error that would be reported [rad], if prismatic [m]; inf if none would be."""
        if len(self._pauses) < SHORTEST:
            return dict.fromkeys(self._robot.joint_names, math.inf)
        zeros = self._zeros(self._window)
        return {name: bar * self._scale_of(name) for name, (*_, bar) in zeros.items()}

    @property
    def _window(self) -> _Chains:
        return _Chains(self._robot, self._pauses, self._ground)

    def update(self, stance: Stance, ground: Mapping[str, tuple[float, float]] | None = None) -> JointReport:
        """Check the joints at a new pause.

        Args:
            stance: joints and standing feet.
            ground: leg -> height of the ground below its sole and its standard deviation [m], where it is known, in
                `base_footprint` of this pause. Only differences of heights count.

        Raises:
            UnknownName, JointPositionError: the joints or legs of the stance are not those of this robot, or a position
                is invalid.
        """
        state, tree = self._robot.state(stance.joint_positions), self._robot.tree
        reading = _Reading(stance, state)
        faults = [
            JointFault((name,), beyond, 0.0, "limit", tree.unit(tree.joint_index(name)))
            for name, beyond in state.beyond_limits.items()
            if beyond > BEYOND_LIMIT * self._scale_of(name)
        ]
        self._count += 1
        residual = math.nan
        stayed: tuple[str, ...] = ()
        if self._pauses:
            stayed, residual, jump = self._since_last(reading)
            if jump is not None:
                self._jump = self._count, jump
        if len(stayed) < 3:
            self._pauses = self._begin(reading)
        else:
            last = self._pauses[-1]
            footholds = {leg: last.footholds[leg] if leg in stayed else self._count for leg in reading.legs}
            self._pauses = (*self._pauses, last.then(reading, stayed, footholds))[-LONGEST:]
        if self._pauses and ground:
            below = math.hypot(self._robot.noise.contact_sigma, RELIEF_SIGMA)
            self._ground = {
                (number, leg): (ground[leg][0], math.hypot(ground[leg][1], below))
                for leg, number in self._pauses[-1].footholds.items()
                if leg in ground
            }
        if len(self._pauses) >= SHORTEST:
            faults += self._in_units(self._offsets(self._window))
        if self._jump is not None and self._count - self._jump[0] < SHORTEST:
            faults += self._in_units([self._jump[1]])
        return JointReport(residual, tuple(faults))

    def _scale_of(self, name: str) -> float:
        return float(self._robot.tree.joint_scales[self._robot.tree.joint_index(name)])

    def _in_units(self, faults: Sequence[JointFault]) -> list[JointFault]:
        """Convert faults from radians to the unit of their first joint."""
        tree, found = self._robot.tree, list[JointFault]()
        for fault in faults:
            scale, unit = self._scale_of(fault.joints[0]), tree.unit(tree.joint_index(fault.joints[0]))
            found.append(replace(fault, error=scale * fault.error, sigma=scale * fault.sigma, unit=unit))
        return found

    def _begin(self, reading: _Reading) -> tuple[_Placed, ...]:
        """Window that starts with this reading; empty if fewer than three feet stand or they are on a line."""
        try:
            plane = fit_support_plane(reading.soles)
        except StanceError:
            return ()
        up = plane.normal if reading.down is None else -reading.down
        transform = transform_base_to_footprint(reading.soles, up)
        return (_Placed(reading, transform[:3, :3], transform[:3, 3], dict.fromkeys(reading.legs, self._count)),)

    def _offsets(self, chains: _Chains) -> list[JointFault]:
        """Find a joint with a wrong zero.

        Joints below their thresholds that explain the readings about as well are named too.
        """
        found, is_reported = {}, False
        for name, (left, error, scaled, bar) in self._zeros(chains).items():
            is_certain = abs(error) > bar
            is_reported |= is_certain
            if is_certain or LEAST_ERROR < abs(error) < LARGEST_JUMP:
                found[name] = left, error, scaled
        fault = _likeliest(found, "offset") if is_reported else None
        return [] if fault is None else [fault]

    def _zeros(self, chains: _Chains) -> dict[str, tuple[float, float, float, float]]:
        """Joint name -> chi^2 once its zero error is corrected, the error, its sigma, and the reporting threshold.

        The sigma is scaled to the residual. The threshold is the smallest error that would be reported, as in `bars`.
        """
        found = {}
        errors, sigmas = chains.errors(since_last=False)
        for name, error, sigma in zip(self._robot.joint_names, errors.tolist(), sigmas.tolist(), strict=True):
            left = chains.chi2 - (error / sigma) ** 2
            scaled = sigma * math.sqrt(max(left / chains.degrees, LEAST_SCALE))
            bars = [most * of for most, of in ((LEAST_SIGMAS, scaled), (STATED_SIGMAS, sigma)) if of < LARGEST_SIGMA]
            found[name] = left, error, scaled, max(LEAST_ERROR, min(bars, default=math.inf))
        return found

    def _since_last(self, reading: _Reading) -> tuple[tuple[str, ...], float, JointFault | None]:
        """Feet that stayed since the last pause, residual of their chains, and fault of a joint that jumped, if any.

        If fewer than three feet stayed, no feet are returned and the residual is NaN.
        """
        last = self._pauses[-1]
        common = [leg for leg in last.reading.legs if leg in reading.legs]
        tried: list[tuple[str, ...]] = []
        for size in range(len(common), 2, -1):
            of_size = []
            for legs in combinations(common, size):
                footholds = dict.fromkeys(legs, 0)
                before = replace(last, footholds=footholds)
                of_size.append((legs, _Chains(self._robot, (before, before.then(reading, legs, footholds)))))
            tried += [legs for legs, _ in of_size]
            stayed, chains = min(of_size, key=lambda each: each[1].chi2)
            if chains.is_consistent:
                moved = last.then(reading, stayed, {})
                tried = [legs for legs in tried if set(legs) >= set(stayed) and self._may_have_stayed(moved, legs)]
                jump = self._jumped(reading, tried)
                if jump is None:
                    self._noise = (*self._noise, (chains.chi2, chains.degrees))[-LEARNED:]
                return stayed, math.sqrt(chains.chi2 / chains.degrees), jump
        return (), math.nan, self._jumped(reading, tried)

    def _scale(self) -> float:
        """Noise variance of this walk as a fraction of that in robot.toml: two-sigma upper bound, LEAST_SCALE ... 1."""
        chi2, degrees = (sum(of) for of in zip(*self._noise, strict=True)) if self._noise else (0.0, 0)
        return min(max(chi2 / degrees * (1.0 + 2.0 * math.sqrt(2.0 / degrees)), LEAST_SCALE), 1.0) if degrees else 1.0

    def _jumped(self, reading: _Reading, tried: Sequence[tuple[str, ...]]) -> JointFault | None:
        """Find a joint whose jump explains a reading after those of the window; `tried`: feet that may have stayed."""
        tree, scale, last = self._robot.tree, self._scale(), self._pauses[-1]
        before = _Chains(self._robot, self._pauses)
        found: dict[str, tuple[float, float, float]] = {}
        for legs in tried:
            now = last.then(reading, legs, {leg: last.footholds[leg] for leg in legs})
            chains = _Chains(self._robot, (*self._pauses, now))
            errors, sigmas = chains.errors(since_last=True)
            for row in (tree.joint_index(name) for leg in legs for name in tree.leg(leg).joints):
                name, error, sigma = tree.joint_names[row], float(errors[row]), float(sigmas[row])
                left = chains.chi2 - before.chi2 - (error / sigma) ** 2
                sigma *= math.sqrt(scale)
                is_explained = left < _most(chains.degrees - before.degrees)
                if max(LEAST_ERROR, LEAST_SIGMAS * sigma) < abs(error) < LARGEST_JUMP and is_explained:
                    found[name] = min(found.get(name, (math.inf, 0.0, 0.0)), (left, error, sigma))
        return _likeliest(found, "jump")

    def _may_have_stayed(self, now: _Placed, legs: Sequence[str]) -> bool:
        """Test that each of these feet moved too little to have been lifted."""
        last = self._pauses[-1]
        here = now.reading.soles_of(legs) @ now.rotation.T + now.origin
        before = last.reading.soles_of(legs) @ last.rotation.T + last.origin
        most = MOST_SWING * self._robot.odometry_limits.swing_least
        return bool((np.linalg.norm(here - before, axis=1) < most).all())


def _likeliest(found: Mapping[str, tuple[float, float, float]], kind: str) -> JointFault | None:
    """Fault of the joint with the smallest chi^2, from (chi^2, error, sigma) by joint; None if there are no joints."""
    if not found:
        return None
    names = sorted(found, key=lambda name: found[name])
    least, error, sigma = found[names[0]]
    return JointFault(tuple(name for name in names if found[name][0] < least + AS_LIKELY), error, sigma, kind)


def _most(degrees: int) -> float:
    """Largest chi^2 attributed to noise."""
    return degrees + 3.0 * math.sqrt(2.0 * degrees) + 6.0
