"""Kinematics of one leg: closed form for hip roll and two or three pitch joints, else numeric.

Such a leg is recognised by its geometry with all joints at zero, not by names: the first axis is parallel to x, the
others are parallel to y, and the second is at the height of the first. With four joints, all joint origins and the
sole also have the same y, and the axes of the sole frame are those of `base_link`. Thigh, shank and foot are vectors of
any direction in the leg's plane, which is perpendicular to the pitch axes, at the distance d (`aside`) from the first
axis. With r the sole relative to the hip and phi the sole's pitch in the plane:

    hip roll     in the plane the sole is at (r_x, -h), h^2 = r_y^2 + r_z^2 - d^2
                 q1 = atan2(r_z, r_y) - atan2(-h, d)
    ankle        a = sole - Ry(phi) foot
    knee bend    cos b = (|a|^2 - l1^2 - l2^2) / (2 l1 l2), b with its sign in the standing posture
    hip pitch    q2 = psi(a) - atan2(l2 sin b, l1 + l2 cos b) - psi(thigh)
    knee         q3 = b + psi(thigh) - psi(shank)
    ankle pitch  q4 = phi - q2 - q3

psi(v) is the angle about y from straight down to v; thigh, shank and foot are the vectors at zero angles, and l1 and l2
the lengths of thigh and shank. The closed form is vectorised over soles. A leg of three joints has no foot and no phi;
its shank ends at a point, or at the centre of the ball of a round foot. This centre is above the sole, slightly to one
side when the ball has rolled (`RobotState.soles_in_base`); its position is found by iteration.

For other legs, `NumericLeg` runs damped Gauss-Newton on a Pinocchio model of that leg alone. Legs of up to three joints
can only place the sole centre; longer legs also solve for the sole's pitch. Soles are solved one at a time, each
starting from the solution of the previous one if there is one, so a grid takes seconds instead of milliseconds.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from kinematics.arrays import Float, read_only
from kinematics.tree import KinematicTree, build_model

# Largest number of iterations of `NumericLeg` from one start.
ITERATIONS = 40
# Damping of the normal equations [m^2 / rad^2], which keeps the step finite when the leg is stretched.
DAMPING = 1e-6
# Weight of pitch relative to position [m / rad]: the height of the ankle of the stock robot guara.
LENGTH = 0.1
# Weighted error [m] below which the iteration has converged.
TOLERANCE = 1e-9
# Step limit [rad], which prevents the first step from flipping the knee.
LARGEST_STEP = 0.3
# Tolerance of lengths [m] and axes [-] in recognising a leg: the closed form must match the URDF up to rounding.
GEOMETRY_TOLERANCE = 1e-9
# Maximum number of iterations for the centre of a ball, and the change at which they end [m]. Each change is about a
# tenth of the previous one, unless the knee is straight; soles without convergence count as out of reach.
BALL_ITERATIONS, BALL_TOLERANCE = 12, 1e-7
# Rounding may make the cosine of a straight knee exceed 1 by this much.
ROUNDING = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class LegGeometry:
    """Lengths and axis directions of a leg of three or four joints.

    Attributes:
        hip: (3,) point of the first axis at the x of the second, in `base_link` [m].
        aside: y of the leg's plane relative to the hip, at zero roll [m].
        senses: (joints,) +1 for an axis along x (first joint) or y (others) of `base_link`, -1 for the opposite axis.
        thigh, shank, foot: (2,) vectors (x, z) in the leg's plane at zero angles [m]; with three joints, foot is zero.
        radius: radius of the ball of a round foot at the end of a leg of three joints [m]; else 0.
        up: (3,) z axis of the sole frame at zero angles.
        knee_sign: sign of the knee bend b in the standing posture.
        lower, upper: (joints,) joint limits [rad].
    """

    hip: Float
    aside: float
    senses: Float
    thigh: Float
    shank: Float
    foot: Float
    radius: float
    up: Float
    knee_sign: float
    lower: Float
    upper: Float

    def soles_in_base(self, joint_positions: npt.ArrayLike) -> Float:
        """Compute sole centres (..., 3) in `base_link` [m] from joint positions (..., joints) [rad]."""
        turns = np.asarray(joint_positions, dtype=np.float64) * self.senses
        return self._end(turns, (self.thigh, self.shank, self.foot)) - self._ball(turns)

    def shanks_in_base(self, joint_positions: npt.ArrayLike) -> tuple[Float, Float]:
        """Compute the upper and lower ends (..., 3) of shanks in `base_link` [m] for joint positions (..., n) [rad]."""
        turns = np.asarray(joint_positions, dtype=np.float64) * self.senses
        return self._end(turns, (self.thigh,)), self._end(turns, (self.thigh, self.shank))

    def solve(self, soles_in_base: Float, sole_pitch: Float) -> Float:
        """Compute the joint positions that place the sole at given points with a given pitch.

        Args:
            soles_in_base: (n, 3) sole centres in `base_link` [m].
            sole_pitch: (n,) pitch of the sole in the leg's plane [rad]; ignored by a leg of three joints.

        Returns:
            (n, joints) joint positions [rad], not checked against limits; NaN where no solution was found.
        """
        ball = np.array([0.0, 0.0, self.radius])
        turns = self._solve(soles_in_base + ball, sole_pitch)
        if self.radius:
            for _ in range(BALL_ITERATIONS):
                last, ball = ball, self._ball(turns)
                turns = self._solve(soles_in_base + ball, sole_pitch)
                missed = np.abs(ball - last).max(axis=-1, initial=0.0)
                if not (missed > BALL_TOLERANCE).any():  # False for NaN: no solution.
                    break
            turns[missed > BALL_TOLERANCE] = np.nan
        return np.asarray(turns * self.senses)

    def _solve(self, ends: Float, sole_pitch: Float) -> Float:
        """Angles (n, joints) about x, y, y, y [rad] that bring the end of the leg to points (n, 3) in `base_link`."""
        reach = ends - self.hip
        with np.errstate(invalid="ignore"):
            down = np.sqrt(reach[:, 1] ** 2 + reach[:, 2] ** 2 - self.aside**2)
        roll = np.arctan2(reach[:, 2], reach[:, 1]) - np.arctan2(-down, self.aside)
        ankle = np.column_stack([reach[:, 0], -down]) - _turned(self.foot, sole_pitch)
        one, two = np.linalg.norm(self.thigh), np.linalg.norm(self.shank)
        cosine = (np.einsum("ni,ni->n", ankle, ankle) - one**2 - two**2) / (2.0 * one * two)
        with np.errstate(invalid="ignore"):
            bend = self.knee_sign * np.arccos(
                np.where(np.abs(cosine) <= 1.0 + ROUNDING, np.clip(cosine, -1.0, 1.0), np.nan)
            )
        thigh = _angle(ankle) - np.arctan2(two * np.sin(bend), one + two * np.cos(bend))
        hip_pitch = thigh - _angle(self.thigh)
        knee = bend + _angle(self.thigh) - _angle(self.shank)
        turns = np.column_stack([roll, hip_pitch, knee, sole_pitch - hip_pitch - knee])[:, : len(self.senses)]
        turns[np.isnan(bend)] = np.nan
        return np.asarray(np.remainder(turns + np.pi, 2.0 * np.pi) - np.pi)

    def _end(self, turns: Float, bones: tuple[Float, ...]) -> Float:
        """End (..., 3) in `base_link` [m] of bones joined in the leg's plane, for angles (..., joints) [rad]."""
        plane, angle = np.zeros((*turns.shape[:-1], 2)), np.zeros(turns.shape[:-1])
        for joint, bone in zip(range(1, turns.shape[-1]), bones, strict=False):
            angle = angle + turns[..., joint]
            plane += _turned(bone, angle)
        return self.hip + _rolled(plane, self.aside, turns[..., 0])

    def _ball(self, turns: Float) -> Float:
        """Vectors (..., 3) from the sole to the centre of the ball [m]."""
        leaning = _rolled(_turned(self.up[::2], turns[..., 1:].sum(axis=-1)), self.up[1], turns[..., 0])
        leaning[..., 2] = 1.0
        return self.radius * leaning


def _rolled(plane: Float, aside: float, roll: Float) -> Float:
    """Convert points (x, z) of the leg's plane, at y = `aside`, to (..., 3) and rotate them about x by `roll` (...)."""
    z, c, s = plane[..., 1], np.cos(roll), np.sin(roll)
    return np.stack([plane[..., 0], c * aside - s * z, s * aside + c * z], axis=-1)


def _turned(vector: Float, angle: Float) -> Float:
    """Rotate a vector (x, z) about y by angles (...) [rad]; returns an array (..., 2)."""
    sine, cosine = np.sin(angle), np.cos(angle)
    return np.stack([vector[0] * cosine + vector[1] * sine, vector[1] * cosine - vector[0] * sine], axis=-1)


def _angle(vectors: Float) -> Float:
    """Angle about y [rad] from straight down (0, -1) to vectors (..., 2)."""
    return np.asarray(np.arctan2(-vectors[..., 0], -vectors[..., 1]))


def find_leg_geometry(tree: KinematicTree, leg: str) -> LegGeometry | None:
    """Geometry of a leg for the closed form; None if the closed form does not apply to the leg.

    Raises:
        UnknownName: the robot has no such leg.
    """
    config = tree.leg(leg)
    path = tree.urdf.path_to(config.sole)
    transform, axes, origins = np.eye(4), [], []
    for joint in path:
        transform = transform @ joint.transform_child_to_parent
        if joint.kind == "revolute":
            axes.append(transform[:3, :3] @ joint.axis)
            origins.append(transform[:3, 3])
    count = len(config.joints)
    if count not in (3, 4) or len(axes) != count:
        return None
    wanted = np.array([[1.0, 0.0, 0.0], *[[0.0, 1.0, 0.0]] * (count - 1)])
    senses = np.sign(np.einsum("ij,ij->i", wanted, axes))
    # A foot with an ankle is level at zero pitch; a foot without one is a ball or a point.
    radius = tree.config.sole_radius if count == 3 else 0.0
    points = np.array([*origins, transform[:3, 3] + radius * transform[:3, 2]])
    aside = points[-1, 1] - points[0, 1]
    is_usual = _close(points[1, 2], points[0, 2]) and _close(np.array(axes), wanted * senses[:, None])
    if count == 4:
        is_usual = is_usual and _close(points[:, 1], points[0, 1]) and _close(transform[:3, :3], np.eye(3))
    if not is_usual:
        return None
    columns = [tree.joint_index(joint) for joint in config.joints]
    lower, upper = tree.lower_limits[columns], tree.upper_limits[columns]
    thigh, shank, *feet = (np.delete(points[i + 1] - points[i], 1) for i in range(1, count))
    if min(np.linalg.norm(thigh), np.linalg.norm(shank)) < GEOMETRY_TOLERANCE:
        return None
    bend = senses[2] * tree.nominal[columns[2]] + _angle(shank) - _angle(thigh)
    return LegGeometry(
        hip=read_only(np.array([points[1, 0], *points[0, 1:]])),
        aside=float(aside),
        senses=read_only(senses),
        thigh=read_only(thigh),
        shank=read_only(shank),
        foot=read_only(feet[0] if feet else np.zeros(2)),
        radius=radius,
        up=read_only(transform[:3, 2]),
        knee_sign=1.0 if bend >= 0.0 else -1.0,
        lower=lower,
        upper=upper,
    )


def _close(a: npt.ArrayLike, b: npt.ArrayLike) -> bool:
    return bool(np.allclose(a, b, rtol=0.0, atol=GEOMETRY_TOLERANCE))


class NumericLeg:
    """Numeric inverse kinematics of a leg of any structure; `solve` takes the arguments of `LegGeometry.solve`.

    Args:
        tree: the robot's kinematic tree.
        leg: name of the leg.
        start: (joints,) initial positions [rad], with the knee bent to the desired side.
    """

    def __init__(self, tree: KinematicTree, leg: str, start: Float) -> None:
        """Build Pinocchio's model of the leg."""
        import pinocchio

        config = tree.leg(leg)
        self._model: Any = build_model(tree.urdf, config.joints)
        self._order = np.array([self._model.joints[self._model.getJointId(joint)].idx_q for joint in config.joints])
        self._sole_radius = tree.config.sole_radius
        self._sole = int(self._model.getFrameId(config.sole, pinocchio.FrameType.BODY))
        columns = [tree.joint_index(joint) for joint in config.joints]
        self.lower, self.upper = tree.lower_limits[columns], tree.upper_limits[columns]
        self._start = np.clip(start, self.lower, self.upper)
        self.seeks_pitch = len(config.joints) >= 4
        data = self._model.createData()
        pinocchio.framesForwardKinematics(self._model, data, self._configuration(self._start))
        self.hip = np.array(data.oMi[1].translation)
        joints = [np.array(data.oMi[index].translation) for index in range(1, self._model.njoints)]
        points = [*joints, np.array(data.oMf[self._sole].translation)]
        self._longest = float(sum(np.linalg.norm(b - a) for a, b in pairwise(points)))

    def _configuration(self, positions: Float) -> Float:
        configuration = np.empty(len(positions))
        configuration[self._order] = positions
        return configuration

    def solve(self, soles_in_base: Float, sole_pitch: Float) -> Float:
        """Find joint positions (n, joints) [rad] within limits for sole centres (n, 3) [m] and pitches (n,) [rad].

        NaN where no solution was found. Legs of three joints or fewer ignore the pitch.
        """
        # Each call has its own Pinocchio data, because solvers are shared between threads.
        data = self._model.createData()
        solutions = np.full((len(soles_in_base), len(self._order)), np.nan)
        last: Float | None = None
        for row, (sole, pitch) in enumerate(zip(soles_in_base, sole_pitch, strict=True)):
            if not np.all(np.isfinite(sole)) or np.linalg.norm(sole - self.hip) > self._longest:
                continue
            found = self._solve_one(data, sole, pitch, last) if last is not None else None
            last = found if found is not None else self._solve_one(data, sole, pitch, self._start)
            if last is not None:
                solutions[row] = last
        return solutions

    def _solve_one(self, data: Any, sole: Float, pitch: float, start: Float) -> Float | None:
        positions = start
        for _ in range(ITERATIONS):
            error, jacobian = self._error(data, positions, sole, pitch)
            if np.linalg.norm(error) < TOLERANCE:
                return positions
            normal = jacobian.T @ jacobian + DAMPING * np.eye(len(positions))
            step = np.linalg.solve(normal, jacobian.T @ error)
            step *= min(1.0, LARGEST_STEP / max(float(np.abs(step).max()), 1e-12))
            positions = np.clip(positions + step, self.lower, self.upper)
        return None

    def _error(self, data: Any, positions: Float, sole: Float, pitch: float) -> tuple[Float, Float]:
        """Weighted error (3,) or (4,) of the sole's pose [m], and weighted Jacobian; columns in the leg's order."""
        import pinocchio

        configuration = self._configuration(positions)
        full = pinocchio.computeFrameJacobian(
            self._model, data, configuration, self._sole, pinocchio.ReferenceFrame.LOCAL_WORLD_ALIGNED
        )[:, self._order]
        placement = data.oMf[self._sole]
        # Height of a round foot as in `RobotState.soles_in_base`. Its small derivative with respect to the joints is
        # neglected; the following iterations correct the effect.
        lifted = self._sole_radius * (1.0 - placement.rotation[2, 2])
        error, jacobian = sole - placement.translation + (0.0, 0.0, lifted), full[:3]
        if not self.seeks_pitch:
            return error, jacobian
        # Pitch is measured in the plane through hip and target that is parallel to the x axis, as in the closed form.
        reach = (sole - self.hip) * (0.0, 1.0, 1.0)
        up = -reach / max(float(np.linalg.norm(reach)), 1e-12)
        along = placement.rotation[:, 0]
        forward, rise = along[0], along @ up
        by_turn = np.cross(along, (rise * np.array([1.0, 0.0, 0.0]) - forward * up) / (forward**2 + rise**2))
        missed = np.remainder(pitch - np.arctan2(-rise, forward) + np.pi, 2.0 * np.pi) - np.pi
        return np.append(error, LENGTH * missed), np.vstack([jacobian, LENGTH * (by_turn @ full[3:])])
