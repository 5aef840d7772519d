"""Sway of a robot in MuJoCo: servos are commanded to sway, and the resulting motion of body and joints is recorded."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from guara_perception.arrays import Float
from guara_perception.simulation.sway import Sway
from guara_perception.simulation.world import World
from kinematics import RobotModel, Stance
from testbed.physics.physics_robot import PhysicsRobot

# Time between two records of the body, and time to settle before the first record.
TICK_S, SETTLE_S = 0.004, 1.0
# Stiffness of the ankles, with which soles stay flat on the ground [Nm/rad]. With the stiffness of the other servos,
# they rock by 2 degrees.
ANKLE_STIFFNESS = 30.0


@dataclass(frozen=True, eq=False)
class PhysicalSway(Sway):
    """Recorded motion of a body; the amplitudes are the commanded ones.

    Attributes:
        record: spline of rotation vector [rad], translation [m] and joint positions [rad], (6 + j,), over time [s].
    """

    record: CubicSpline = field(kw_only=True)

    def at(self, time: float) -> Float:
        """Pose of `base_link`, as in `Sway`."""
        values, transform = self.record(time), np.eye(4)
        transform[:3, :3] = Rotation.from_rotvec(values[:3]).as_matrix()
        transform[:3, 3] = values[3:6]
        return transform

    def joints_at(self, robot: RobotModel, time: float) -> Float:
        """True joint positions, as in `Sway`."""
        return np.asarray(self.record(time)[6:])


def physical(robot: RobotModel, told: Sway, start: float, end: float) -> PhysicalSway:
    """Simulate the commanded sway `told` on level ground in MuJoCo, between two times [s].

    Raises:
        MissingExtra: MuJoCo is not installed.
    """
    names = robot.tree.joint_names
    posture = robot.posture(robot.config.scan_posture)
    standing = robot.stance_pose(Stance(posture, robot.legs, None)).transform_base_to_footprint
    body = PhysicsRobot(World(), robot, standing, posture, ANKLE_STIFFNESS)
    body.run(_joints(robot, told, start), SETTLE_S)
    times, rows = np.arange(start, end + TICK_S, TICK_S), list[Float]()
    for time in times.tolist():
        moved, joints = np.linalg.inv(standing) @ body.transform_base_to_world, body.joint_positions
        turn = Rotation.from_matrix(moved[:3, :3]).as_rotvec()
        rows.append(np.concatenate((turn, moved[:3, 3], [joints[name] for name in names])))
        body.run(_joints(robot, told, time + TICK_S), TICK_S)
    return PhysicalSway(told.turn, told.shift, told.frequency, told.speed, record=CubicSpline(times, np.array(rows)))


def _joints(robot: RobotModel, sway: Sway, time: float) -> dict[str, float]:
    return dict(zip(robot.tree.joint_names, sway.joints_at(robot, time).tolist(), strict=True))
