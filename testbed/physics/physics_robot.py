"""Robot in MuJoCo with position servos, which stands on level ground with boxes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from guara_perception.arrays import Float
from guara_perception.exceptions import optional_library
from guara_perception.simulation.world import World
from testbed.physics.ground import add_ground
from testbed.physics.mujoco_robot import SERVO_DAMPING, SERVO_STIFFNESS, STEP_S, mujoco_robot

if TYPE_CHECKING:
    from kinematics import RobotModel


class PhysicsRobot:
    """Position-controlled robot in a physical world; time passes only in `run`.

    Example:
        robot = PhysicsRobot(world, load_robot("guara"), transform_base_to_world, joint_positions)
        robot.run(joint_positions, 1.0)
    """

    def __init__(
        self,
        world: World,
        robot: RobotModel,
        transform_base_to_world: Float,
        joint_positions: Mapping[str, float],
        ankle_stiffness: float = SERVO_STIFFNESS,
    ) -> None:
        """Create the robot in a pose.

        Args:
            world: level ground with boxes on it.
            robot: the robot.
            transform_base_to_world: (4, 4) initial pose of the base.
            joint_positions: initial joint positions by name [rad].
            ankle_stiffness: stiffness of the servos of each leg's fourth joint [Nm/rad].

        Raises:
            MissingExtra: MuJoCo is not installed.
            InvalidInput: as in `add_ground`.
        """
        self._mujoco = optional_library("mujoco", "sim", "the physical simulation")
        self._names = robot.joint_names
        self._model = self._build(world, robot, ankle_stiffness)
        self._data: Any = self._mujoco.MjData(self._model)
        self._positions = [self._model.joint(name).qposadr[0] for name in self._names]
        self._servos = [self._model.actuator(name).id for name in self._names]
        quaternion = np.zeros(4)
        self._mujoco.mju_mat2Quat(quaternion, transform_base_to_world[:3, :3].ravel().copy())
        self._data.qpos[:3] = transform_base_to_world[:3, 3]
        self._data.qpos[3:7] = quaternion
        self._data.qpos[self._positions] = [joint_positions[name] for name in self._names]
        self._command(joint_positions)
        self._mujoco.mj_forward(self._model, self._data)

    @property
    def time(self) -> float:
        """Time since the start [s]."""
        return float(self._data.time)

    @property
    def joint_positions(self) -> dict[str, float]:
        """True joint positions, by name [rad]."""
        return dict(zip(self._names, self._data.qpos[self._positions].tolist(), strict=True))

    @property
    def transform_base_to_world(self) -> Float:
        """True pose (4, 4) of the body in the world."""
        rotation = np.zeros(9)
        self._mujoco.mju_quat2Mat(rotation, self._data.qpos[3:7])
        transform = np.eye(4)
        transform[:3, :3] = rotation.reshape(3, 3)
        transform[:3, 3] = self._data.qpos[:3]
        return transform

    def run(self, joint_positions: Mapping[str, float], seconds: float) -> None:
        """Simulate for a time [s], with the servos set to these joint positions by name [rad]."""
        self._command(joint_positions)
        self._mujoco.mj_step(self._model, self._data, max(round(seconds / STEP_S), 1))

    def _command(self, joint_positions: Mapping[str, float]) -> None:
        self._data.ctrl[self._servos] = [joint_positions[name] for name in self._names]

    def _build(self, world: World, robot: RobotModel, ankle_stiffness: float) -> Any:
        spec = mujoco_robot(robot)
        for ankle in (name for leg in robot.legs for name in robot.tree.leg(leg).joints[3:]):
            damping = SERVO_DAMPING * ankle_stiffness / SERVO_STIFFNESS
            spec.actuator(ankle).set_to_position(kp=ankle_stiffness, kv=damping)
        add_ground(spec, world)
        return spec.compile()
