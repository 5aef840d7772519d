"""A worse robot: the same crawl by position servos alone, which push the feet against each other: they creep."""

from __future__ import annotations

import numpy as np

from guara_perception.arrays import Float
from testbed.physics.crawl import FALLEN_M, FALLEN_UP, FROZEN_S, HELD_STEPS, TICK_S, Crawl, Fell, Swing
from testbed.physics.mujoco_robot import SERVO_DAMPING, SERVO_STIFFNESS
from testbed.physics.robot import Robot

# [Nm/rad] The weight on an edge of a sole turns it by less than 0.01 rad.
RIGID_SOLE = 100.0


class StiffCrawl(Crawl):
    """Moves a robot by joint positions; what carries the body is what the servos give way."""

    def __init__(self, robot: Robot) -> None:
        """Take a robot that stands, and let it settle."""
        self._standing = robot.feet
        # In the joints, where MuJoCo takes it as implicit: as a torque it would shake.
        robot.model.dof_damping[robot.dofs] = SERVO_DAMPING
        # Flat soles stand as their URDF says, on an edge where their leg leans.
        robot.model.jnt_stiffness[robot.model.jnt_stiffness > 0] = RIGID_SOLE
        super().__init__(robot)

    def freeze(self) -> None:
        """Servos stay where they are told to be; the next step begins where the feet have come to."""
        for _ in range(round(FROZEN_S / TICK_S)):
            self._tick(self._com, np.zeros(3), self._rotation, np.zeros(3), None)
        self._standing, self._com, self._rotation = self.robot.feet, self.robot.com, self.robot.rotation

    def _tick(self, com: Float, speed: Float, rotation: Float, turn: Float, swing: Swing | None) -> None:
        robot = self.robot
        if swing is not None:
            self._standing[swing[0]] = swing[1]
        base = com - rotation @ robot.com_in_base
        # A leg that cannot reach stays as it is.
        error = np.nan_to_num(robot.joints_at(self._standing, base, rotation) - robot.joint_positions)
        robot.advance(SERVO_STIFFNESS * error, HELD_STEPS)
        if robot.rotation[2, 2] < FALLEN_UP or robot.base[2] - robot.feet[:, 2].mean() < FALLEN_M:
            raise Fell("the body tipped over or lies on the ground")
