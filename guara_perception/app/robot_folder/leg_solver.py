"""Inverse kinematics of a leg of which only the joints are known: finds how it stands over a point."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np

from guara_perception.app.robot_folder.feet import Foot
from guara_perception.app.robot_folder.find_legs import FoundLeg
from guara_perception.arrays import Float
from kinematics.leg import NumericLeg
from kinematics.robot_toml import LegConfig, RobotToml
from kinematics.toml_table import Table
from kinematics.tree import KinematicTree
from kinematics.urdf import Joint, Link, Urdf
from kinematics.urdf_checks import root_link

# Angles from which the search starts, besides the centre of the limits [rad].
STARTS = (-1.6, -0.8, 0.0, 0.8, 1.6)
TIP = "tip of the leg"


class LegSolver:
    """One leg with its foot's tip as sole.

    Attributes:
        leg: leg as found in the URDF.
        foot: the foot of this leg.
        pitch_joint: (3,) origin in the base of the first joint that swings the foot fore and aft, all at zero [m].
        hip: the link which that joint carries.
        side: the tip's y with the hip's roll at zero [m].
        length: length of the stretched leg from the pitch joint to the tip [m].
    """

    def __init__(self, urdf: Urdf, leg: FoundLeg, foot: Foot) -> None:
        """Measure the leg with all joints at zero."""
        self.leg, self.foot = leg, foot
        self._last: Float | None = None
        self._tree = _with_tip(urdf, leg, foot)
        joints = {joint.name: joint for joint in urdf.joints}
        origins, axes = [], []
        transform = np.eye(4)
        for joint in self._tree.urdf.path_to(TIP):
            transform = transform @ joint.transform_child_to_parent
            if joint.kind != "fixed":
                origins.append(transform[:3, 3].copy())
                axes.append(transform[:3, :3] @ joint.axis)
        swings = [i for i, axis in enumerate(axes) if abs(axis[1]) > 0.7]
        first = swings[0] if swings else 0
        self.pitch_joint: Float = origins[first]
        self.hip = joints[leg.joints[first]].child
        self.side = float(transform[1, 3])
        points = [*origins[first:], transform[:3, 3]]
        self.length = float(sum(np.linalg.norm(b - a) for a, b in zip(points, points[1:], strict=False)))

    def solver(self, start: Float) -> NumericLeg:
        """The numeric solver that starts from joint positions."""
        return NumericLeg(self._tree, self.leg.name, start)

    def stand_over(self, tip: Float) -> Float | None:
        """Joint positions that put the tip at (3,) in the base [m], knees inwards; None = out of reach."""
        columns = [self._tree.joint_index(joint) for joint in self.leg.joints]
        lower, upper = self._tree.lower_limits[columns], self._tree.upper_limits[columns]
        best, found = np.inf, None
        pitch = np.zeros(1)
        if self._last is not None:
            again = self.solver(self._last).solve(tip[None], pitch)[0]
            if not np.any(np.isnan(again)):
                self._last = again
                return again
        starts = [
            (lower + upper) / 2.0,
            *(np.array([0.0, *angles]) for angles in product(STARTS, repeat=len(columns) - 1)),
        ]
        for start in starts:
            solution = self.solver(start).solve(tip[None], pitch)[0]
            if np.any(np.isnan(solution)):
                continue
            cost = self._cost(solution, tip)
            if cost < best - 1e-6:
                best, found = cost, solution
        self._last = found
        return found

    def _cost(self, positions: Float, tip: Float) -> float:
        """Least for a hip that does not roll and a knee on the side of the body's centre."""
        state = self.transforms(positions)
        knee = state[-1][:3, 3] if len(state) < 4 else state[2][:3, 3]
        outward = float(np.sign(self.leg.start[0]) * (knee[0] - (tip[0] + self.pitch_joint[0]) / 2.0))
        return outward * 2.0 + float(np.abs(positions[0])) + 0.01 * float(np.abs(positions).sum())

    def transforms(self, positions: Float) -> list[Float]:
        """transform_link_to_base (4, 4) of the links that the joints of the leg carry, one after the other."""
        angles = dict(zip(self.leg.joints, positions.tolist(), strict=True))
        transform, found = np.eye(4), []
        for joint in self._tree.urdf.path_to(self.foot.link):
            transform = transform @ joint.transform_child_to_parent
            if joint.kind != "fixed":
                transform = transform @ _moved(joint, angles.get(joint.name, 0.0))
                found.append(transform)
        return found

    def foot_rotation(self, positions: Float) -> Float:
        """Rotation (3, 3) of the last link in the base."""
        return np.asarray(self.transforms(positions)[-1][:3, :3])


def _moved(joint: Joint, value: float) -> Float:
    transform = np.eye(4)
    if joint.kind == "prismatic":
        transform[:3, 3] = joint.axis * value
        return transform
    x, y, z = joint.axis / np.linalg.norm(joint.axis)
    k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    transform[:3, :3] = np.eye(3) + np.sin(value) * k + (1.0 - np.cos(value)) * k @ k
    return transform


def _with_tip(urdf: Urdf, leg: FoundLeg, foot: Foot) -> KinematicTree:
    placed = np.eye(4)
    placed[:3, 3] = foot.tip
    link = Link(TIP, None, np.zeros(3), np.zeros((3, 3)), ())
    mount = Joint(TIP, "fixed", foot.link, TIP, placed, np.array([1.0, 0.0, 0.0]), 0.0, 0.0)
    extended = replace(urdf, links=(*urdf.links, link), joints=(*urdf.joints, mount))
    root = root_link(urdf)
    config = RobotToml(
        path=Path(urdf.path),
        name=urdf.name,
        sole=(0.01, 0.01),
        scan_posture="",
        base_frame=root,
        camera_frame=root,
        laser_frame=root,
        imu_frame=None,
        legs=(LegConfig(leg.name, foot.link, TIP, leg.joints),),
        postures=(),
        root=Table(urdf.path, "", {}),
    )
    return KinematicTree(extended, config)
