"""Crawl with position servos only, which push the feet against each other, so that the feet creep."""

from __future__ import annotations

import numpy as np

from guara_perception.arrays import Float
from testbed.physics.crawl import FALLEN_M, FALLEN_UP, FROZEN_S, HELD_STEPS, TICK_S, Crawl, Fell, Swing
from testbed.physics.mujoco_robot import SERVO_DAMPING, SERVO_STIFFNESS
from testbed.physics.robot import Robot

# Stiffness of a sole's hinge [Nm/rad]: the weight on an edge turns the sole by less than 0.01 rad.
RIGID_SOLE = 100.0


class StiffCrawl(Crawl):
    """Position controller of a robot; the weight of the body deflects the servos."""

    def __init__(self, robot: Robot) -> None:
        """Let a standing robot settle."""
        self._standing = robot.feet
        # Damping is set in the joints, where MuJoCo integrates it implicitly; as a torque, it would cause vibrations.
        robot.model.dof_damping[robot.dofs] = SERVO_DAMPING
        # Flat soles are nearly rigid, as in the URDF; below an inclined leg, they stand on an edge.
        robot.model.jnt_stiffness[robot.model.jnt_stiffness > 0] = RIGID_SOLE
        super().__init__(robot)

    def freeze(self) -> None:
        """Hold the commanded positions; the next step begins at the resulting positions of the feet."""
        for _ in range(round(FROZEN_S / TICK_S)):
            self._tick(self._com, np.zeros(3), self._rotation, np.zeros(3), None)
        self._standing, self._com, self._rotation = self.robot.feet, self.robot.com, self.robot.rotation

    def _tick(self, com: Float, speed: Float, rotation: Float, turn: Float, swing: Swing | None) -> None:
        robot = self.robot
        if swing is not None:
            self._standing[swing[0]] = swing[1]
        base = com - rotation @ robot.com_in_base
        # A leg that cannot reach its foothold is not moved.
        error = np.nan_to_num(robot.joints_at(self._standing, base, rotation) - robot.joint_positions)
        robot.advance(SERVO_STIFFNESS * error, HELD_STEPS)
        if robot.rotation[2, 2] < FALLEN_UP or robot.base[2] - robot.feet[:, 2].mean() < FALLEN_M:
            raise Fell("the body tipped over or lies on the ground")
