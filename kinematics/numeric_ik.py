"""Inverse kinematics of any leg by damped Gauss-Newton on Pinocchio's model of that leg alone.

Used where the closed form does not fit. The sole centre is always sought; its pitch only by legs of four joints or
more, since three joints can just place it. One sole at a time, started from the one before: a grid takes seconds,
not milliseconds.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from kinematics.arrays import Float
from kinematics.pinocchio_model import build_model
from kinematics.tree import KinematicTree

ITERATIONS = 40
# Damping of the normal equations [m^2 / rad^2]: keeps the step finite where the leg is stretched.
DAMPING = 1e-6
# A radian of pitch weighs as much as this many metres: half a foot's height.
LENGTH = 0.1
# Weighted error [m] below which a solution is found.
TOLERANCE = 1e-9
# [rad] Keeps a first step from jumping to the other bend of the knee.
LARGEST_STEP = 0.3


class NumericLeg:
    """One leg of any build; `solve` answers as `LegGeometry.solve` does.

    Args:
        tree: the robot's kinematic tree.
        leg: name of the leg.
        start: (joints,) positions to start from [rad], on the side to which the knee should bend.
    """

    def __init__(self, tree: KinematicTree, leg: str, start: Float) -> None:
        """Build Pinocchio's model of the leg."""
        import pinocchio

        config = tree.leg(leg)
        self._model: Any = build_model(tree.urdf, config.joints)
        self._order = np.array([self._model.joints[self._model.getJointId(joint)].idx_q for joint in config.joints])
        self._sole = int(self._model.getFrameId(config.sole, pinocchio.FrameType.BODY))
        columns = [tree.joint_index(joint) for joint in config.joints]
        self.lower, self.upper = tree.lower_limits[columns], tree.upper_limits[columns]
        self._start = np.clip(start, self.lower, self.upper)
        self.seeks_pitch = len(config.joints) >= 4
        data = self._model.createData()
        pinocchio.framesForwardKinematics(self._model, data, self._configuration(self._start))
        self._hip = np.array(data.oMi[1].translation)
        joints = [np.array(data.oMi[index].translation) for index in range(1, self._model.njoints)]
        points = [*joints, np.array(data.oMf[self._sole].translation)]
        self._longest = float(sum(np.linalg.norm(b - a) for a, b in zip(points, points[1:], strict=False)))

    def _configuration(self, positions: Float) -> Float:
        configuration = np.empty(len(positions))
        configuration[self._order] = positions
        return configuration

    def solve(self, soles_in_base: Float, sole_pitch: Float) -> Float:
        """Joint positions (n, joints) [rad] within limits for sole centres (n, 3) [m] and pitches (n,) [rad].

        NaN where none was found. The pitch is ignored by legs of three joints or fewer.
        """
        # Pinocchio's work space, one for each call: solvers are shared between threads.
        data = self._model.createData()
        solutions = np.full((len(soles_in_base), len(self._order)), np.nan)
        last: Float | None = None
        for row, (sole, pitch) in enumerate(zip(soles_in_base, sole_pitch, strict=True)):
            if not np.all(np.isfinite(sole)) or np.linalg.norm(sole - self._hip) > self._longest:
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
        """Weighted error (3 or 4,) [m] and its Jacobian by the joints, with columns in the leg's order."""
        import pinocchio

        configuration = self._configuration(positions)
        full = pinocchio.computeFrameJacobian(
            self._model, data, configuration, self._sole, pinocchio.ReferenceFrame.LOCAL_WORLD_ALIGNED
        )[:, self._order]
        placement = data.oMf[self._sole]
        error, jacobian = sole - placement.translation, full[:3]
        if not self.seeks_pitch:
            return error, jacobian
        # The pitch is read in the plane through the x axis, the hip and the wanted sole, as the closed form does.
        reach = (sole - self._hip) * (0.0, 1.0, 1.0)
        up = -reach / max(float(np.linalg.norm(reach)), 1e-12)
        along = placement.rotation[:, 0]
        forward, rise = along[0], along @ up
        by_turn = np.cross(along, (rise * np.array([1.0, 0.0, 0.0]) - forward * up) / (forward**2 + rise**2))
        missed = np.remainder(pitch - np.arctan2(-rise, forward) + np.pi, 2.0 * np.pi) - np.pi
        return np.append(error, LENGTH * missed), np.vstack([jacobian, LENGTH * (by_turn @ full[3:])])
