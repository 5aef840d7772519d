"""The robot in MuJoCo: the same URDF with position servos, standing on boxes, pushed around by real contacts."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from guara_perception.arrays import Float
from guara_perception.exceptions import InvalidInput, optional_library
from guara_perception.simulation.features import Box, Patch
from guara_perception.simulation.world import World
from testbed.physics.mujoco_robot import FRICTION, SERVO_DAMPING, SERVO_STIFFNESS, STEP_S, mujoco_robot

if TYPE_CHECKING:
    from kinematics import RobotModel


ROBOT_BIT, TERRAIN_BIT = 1, 2
GROUND_THICKNESS_M = 0.05
# Steps of the physics from one command to the next.
COMMAND_STEPS = 5


class PhysicsRobot:
    """A robot in a physical world; time goes on only in `run`.

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
        """Build it, standing in a pose.

        Args:
            world: level ground with boxes on it.
            robot: the robot.
            transform_base_to_world: (4, 4) pose of the base at the start.
            joint_positions: positions of the joints at the start, by name [rad].
            ankle_stiffness: of the servos of a leg's fourth joint [Nm/rad].

        Raises:
            MissingExtra: MuJoCo is not installed.
            InvalidInput: the world holds something else than boxes and patches.
        """
        self._mujoco = optional_library("mujoco", "sim", "the physical simulation")
        self._names = robot.joint_names
        self._model = self._build(world, robot, ankle_stiffness)
        self._data: Any = self._mujoco.MjData(self._model)
        self._positions = [self._model.joint(name).qposadr[0] for name in self._names]
        self._dofs = [self._model.joint(name).dofadr[0] for name in self._names]
        self._servos = [self._model.actuator(name).id for name in self._names]
        self._soles = {leg: self._model.body(robot.tree.leg(leg).sole).id for leg in robot.legs}
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
        """True pose of the body, (4, 4)."""
        rotation = np.zeros(9)
        self._mujoco.mju_quat2Mat(rotation, self._data.qpos[3:7])
        transform = np.eye(4)
        transform[:3, :3] = rotation.reshape(3, 3)
        transform[:3, 3] = self._data.qpos[:3]
        return transform

    def run(
        self, joint_positions: Mapping[str, float], seconds: float, carried_by: Mapping[str, float] | None = None
    ) -> None:
        """Let time go on with the servos set to these positions [rad].

        Args:
            joint_positions: where the servos hold the joints, by name.
            seconds: time.
            carried_by: legs whose servos are told the torques that carry the body, each with the weight of its share;
                None = position servos alone, which push the feet against each other.
        """
        for step in range(max(round(seconds / STEP_S), 1)):
            if step % COMMAND_STEPS == 0:
                self._command(joint_positions, carried_by)
            self._mujoco.mj_step(self._model, self._data)

    def _command(self, joint_positions: Mapping[str, float], carried_by: Mapping[str, float] | None = None) -> None:
        positions = np.array([joint_positions[name] for name in self._names])
        if carried_by is not None:
            positions += self._carrying(carried_by) / SERVO_STIFFNESS
        self._data.ctrl[self._servos] = positions

    def _carrying(self, shares: Mapping[str, float]) -> Float:
        """Torques of all joints that carry the body, by the least vertical forces at the soles [Nm].

        Args:
            shares: weight of each leg; a leg without load has 0.
        """
        soles = [self._soles[leg] for leg in shares]
        rows = np.vstack((np.ones(len(soles)), self._data.xpos[soles, :2].T))
        weight = self._model.body_subtreemass[0] * -self._model.opt.gravity[2]
        weighted = rows * np.array(list(shares.values()))
        wanted = weight * np.append(1.0, self._data.subtree_com[0, :2])
        forces = weighted.T @ np.linalg.lstsq(weighted @ rows.T, wanted, rcond=None)[0]
        torques = np.array(self._data.qfrc_bias)
        for sole, force in zip(soles, forces, strict=True):
            jacobian = np.zeros((3, self._model.nv))
            self._mujoco.mj_jacBody(self._model, self._data, jacobian, None, sole)
            torques -= max(float(force), 0.0) * jacobian[2]
        return np.asarray(torques[self._dofs])

    def _build(self, world: World, robot: RobotModel, ankle_stiffness: float) -> Any:
        spec = mujoco_robot(robot)
        for ankle in (name for leg in robot.legs for name in robot.tree.leg(leg).joints[3:]):
            damping = SERVO_DAMPING * ankle_stiffness / SERVO_STIFFNESS
            spec.actuator(ankle).set_to_position(kp=ankle_stiffness, kv=damping)
        for geom in spec.geoms:
            # The robot touches the terrain, never itself.
            geom.contype, geom.conaffinity = ROBOT_BIT, TERRAIN_BIT
        self._add_terrain(spec, world)
        return spec.compile()

    def _add_terrain(self, spec: Any, world: World) -> None:
        if world.undulation > 0:
            raise InvalidInput(f"the world undulates by {world.undulation} m: physics needs level ground")
        common = {
            "contype": TERRAIN_BIT,
            "conaffinity": ROBOT_BIT,
            "friction": FRICTION,
        }
        plane = self._mujoco.mjtGeom.mjGEOM_PLANE
        spec.worldbody.add_geom(name="ground", type=plane, size=[0, 0, GROUND_THICKNESS_M], **common)
        for number, feature in enumerate(world.features):
            if isinstance(feature, Patch):
                continue
            if not isinstance(feature, Box):
                kind = type(feature).__name__.lower()
                raise InvalidInput(f"the world holds a {kind}: physics knows level ground, boxes and patches only")
            top = float(world.height(feature.x, feature.y))
            spec.worldbody.add_geom(
                name=f"box_{number}",
                type=self._mujoco.mjtGeom.mjGEOM_BOX,
                size=[feature.size[0] / 2, feature.size[1] / 2, top / 2],
                pos=[feature.x, feature.y, top / 2],
                quat=[np.cos(feature.yaw / 2), 0, 0, np.sin(feature.yaw / 2)],
                **common,
            )
