"""The Go2 in MuJoCo, driven by torques: its model, true state and the inverse kinematics of its legs.

Another robot derives from `Robot`.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from guara_perception.app.robot_folder.new_robot import new_robot
from guara_perception.arrays import Float
from guara_perception.exceptions import optional_library
from guara_perception.simulation.world import World
from kinematics import RobotModel, load_robot
from kinematics.transforms import transform_points
from testbed.physics.ground import add_ground
from testbed.physics.mujoco_robot import FRICTION, STEP_S, mujoco_robot
from testbed.stock_robots import stock_urdf

LEGS = ("lf", "rf", "lh", "rh")
PREFIXES = ("FL", "FR", "RL", "RR")
SIDE = np.array([1.0, -1.0, 1.0, -1.0])
# The ball of a foot; the stock URDF has a cylinder of this radius there.
FOOT_RADIUS_M = 0.023
# Stock values of hip, thigh and calf, which the URDF lacks [Nm].
TORQUE_LIMIT = np.array([23.7, 23.7, 45.43] * 4)
# Inertia of the rotors and viscous friction of the gears.
ARMATURE, DAMPING = 0.01, 0.1
# Pull of a foot in the air to its place: acceleration per metre, per metre a second.
SWING_PULL, SWING_BRAKE = 1200.0, 60.0


@lru_cache(maxsize=1)
def go2() -> RobotModel:
    """The robot folder that `guara robot new` makes of the stock URDF.

    Raises:
        StockRobotsMissing: the extra `robots-test` is not installed.
    """
    with tempfile.TemporaryDirectory() as folder:
        new_robot(stock_urdf("go2"), Path(folder) / "go2")
        return load_robot(str(Path(folder) / "go2"))


class Robot:
    """A Go2 on some ground; time goes on in `advance` alone. All that it tells is true.

    Attributes:
        sole: length and width of a flat sole; None = balls [m].
        heights: of the body over its feet, best first [m].
        clearance: of a foot in the air [m].
        dry_friction: of a gear [Nm].
        start: where the body begins a course, along x [m].
        slid: (4, 2) way that each foot slid since the start, also in the air; a ball that rolls does not slide [m].
    """

    heights, torque_limit = (0.295, 0.27, 0.245), TORQUE_LIMIT
    clearance, dry_friction, start = 0.05, 0.2, 0.0
    sole: Float | None = None

    def __init__(self, world: World, start: float = 0.0, feet: Float | None = None) -> None:
        """Build it, level, its feet on level ground.

        Args:
            world: the ground.
            start: where the body begins, along x [m].
            feet: (4, 2) positions of the feet in base; None = below the hips [m].
        """
        self._mujoco = optional_library("mujoco", "sim", "a crossing")
        self.product = self._product()
        self.model = self._build(world)
        self.data: Any = self._mujoco.MjData(self.model)
        model = self.model
        self.body = model.body(self.product.config.base_frame).id
        self.mass = float(model.body_subtreemass[self.body])
        self._feet = [model.body(name).id for name in self._foot_names()]
        names = [name for leg in LEGS for name in self.product.tree.leg(leg).joints]
        self.joint_names = names
        self._positions = np.array([model.joint(name).qposadr[0] for name in names])
        self.dofs = np.array([model.joint(name).dofadr[0] for name in names])
        self.data.qpos[[0, 2]] = start, self.heights[0]
        self._prepare()
        below = np.column_stack((self.lanes() if feet is None else feet, np.zeros(4)))
        self.data.qpos[self._positions] = self.joints_at(below, np.array([0, 0, self.heights[0]]), np.eye(3))
        self._jacobian, self._turn_jacobian = np.zeros((3, model.nv)), np.zeros((3, model.nv))
        self._mujoco.mj_forward(model, self.data)
        self._mujoco.mj_subtreeVel(model, self.data)
        self.slid = np.zeros((4, 2))
        self.com_in_base = self.rotation.T @ (self.com - self.base)

    def _product(self) -> RobotModel:
        return go2()

    def _foot_names(self) -> list[str]:
        """Bodies that touch the ground."""
        return [f"{prefix}_foot" for prefix in PREFIXES]

    def _prepare(self) -> None:
        """Read from MuJoCo's model what the inverse kinematics need."""
        self.legs = Legs.of(self.model)

    def lanes(self) -> Float:
        """Feet below the hips (4, 2), in base [m]."""
        return np.column_stack((self.legs.hips[:, 0], self.legs.lanes))

    def joints_at(self, feet: Float, base: Float, rotation: Float) -> Float:
        """Joint positions with the feet (4, 3) there under a pose of the body; NaN out of reach [rad]."""
        return self.legs.joints((feet + (0, 0, FOOT_RADIUS_M) - base) @ rotation)[0].ravel()

    @property
    def rotation(self) -> Float:
        """Attitude of the body, (3, 3)."""
        return np.array(self.data.xmat[self.body]).reshape(3, 3)

    @property
    def base(self) -> Float:
        """Position of the body (3,) [m]."""
        return np.array(self.data.xpos[self.body])

    @property
    def transform_base_to_world(self) -> Float:
        """Pose of the body, (4, 4)."""
        transform = np.eye(4)
        transform[:3, :3], transform[:3, 3] = self.rotation, self.base
        return transform

    @property
    def com(self) -> Float:
        """Centre of mass (3,) [m]."""
        return np.array(self.data.subtree_com[self.body])

    @property
    def feet(self) -> Float:
        """Lowest points of the feet (4, 3) [m]."""
        return np.asarray(self.data.xpos[self._feet] - (0, 0, FOOT_RADIUS_M))

    def feet_by(self, joints: Float, base: Float) -> Float:
        """Lowest points of the feet (4, 3) by joint positions [rad] and a pose of the body (4, 4) [m]."""
        return transform_points(base, self.legs.balls(joints)) - (0, 0, FOOT_RADIUS_M)

    @property
    def joint_positions(self) -> Float:
        """(joints,) [rad], in the order of `joint_names`."""
        return np.array(self.data.qpos[self._positions])

    @property
    def joints(self) -> dict[str, float]:
        """Joint positions by name [rad]."""
        return dict(zip(self.joint_names, self.joint_positions.tolist(), strict=True))

    @property
    def joint_speeds(self) -> Float:
        """(joints,) [rad/s]."""
        return np.array(self.data.qvel[self.dofs])

    @property
    def turn_rate(self) -> Float:
        """Of the body, in the world (3,) [rad/s]."""
        return self.rotation @ np.array(self.data.qvel[3:6])

    def moving(self, leg: int, place: Float, velocity: Float, acceleration: Float) -> Float:
        """Torques of all joints that move a foot in the air, to a place at a speed [Nm]."""
        joints, torques = slice(3 * leg, 3 * leg + 3), np.zeros(len(self.dofs))
        jacobian, dofs = self.jacobian(leg), self.dofs[joints]
        slow = velocity - jacobian @ self.data.qvel
        wanted = acceleration + SWING_PULL * (place - self.feet[leg]) + SWING_BRAKE * slow
        inertia = self.mass_matrix()[np.ix_(dofs, dofs)]
        torques[joints] = inertia @ np.linalg.solve(jacobian[:, dofs], wanted)
        return torques

    def levelling(self, legs: Iterable[int]) -> Float:
        """Torques of all joints that keep the soles of standing legs level [Nm]; none of round feet."""
        return np.zeros(len(self.dofs))

    def jacobian(self, leg: int) -> Float:
        """Velocity of a foot by all velocities, (3, nv)."""
        at, body = self.feet[leg], self._feet[leg]
        self._mujoco.mj_jac(self.model, self.data, self._jacobian, self._turn_jacobian, at, body)
        return self._jacobian.copy()

    def mass_matrix(self) -> Float:
        """Inertia of all velocities, (nv, nv)."""
        full = np.zeros((self.model.nv, self.model.nv))
        self._mujoco.mj_fullM(self.model, self.data, full)
        return full

    def load(self, leg: int) -> float:
        """Force of the ground on a foot along its normal [N]."""
        force, load = np.zeros(6), 0.0
        for i in range(self.data.ncon):
            geoms = self.data.contact[i].geom
            if self._feet[leg] in self.model.geom_bodyid[geoms]:
                self._mujoco.mj_contactForce(self.model, self.data, i, force)
                load += force[0]
        return load

    def advance(self, torques: Float, steps: int = 1) -> None:
        """Let time go on under these torques of the joints [Nm]."""
        self.data.ctrl[:] = np.clip(torques, -self.torque_limit, self.torque_limit)
        self._mujoco.mj_step(self.model, self.data, steps)
        self._mujoco.mj_subtreeVel(self.model, self.data)
        for leg in range(4):
            self.slid[leg] += (self.jacobian(leg) @ self.data.qvel)[:2] * steps * STEP_S

    def _build(self, world: World) -> Any:
        mujoco = self._mujoco
        spec = mujoco_robot(self.product)
        for servo in list(spec.actuators):
            spec.delete(servo)
        self._make_feet(spec)
        for name in (name for leg in LEGS for name in self.product.tree.leg(leg).joints):
            joint = spec.joint(name)
            joint.armature, joint.damping, joint.frictionloss = ARMATURE, np.r_[DAMPING, 0, 0], self.dry_friction
            spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT).set_to_motor()
        add_ground(spec, world)
        return spec.compile()

    def _make_feet(self, spec: Any) -> None:
        """Balls in place of the cylinders of the stock URDF."""
        for name in self._foot_names():
            foot = spec.body(name)
            for geom in list(foot.geoms):
                spec.delete(geom)
            ball = self._mujoco.mjtGeom.mjGEOM_SPHERE
            foot.add_geom(type=ball, size=[FOOT_RADIUS_M, 0, 0], mass=0, friction=FRICTION)


class Legs:
    """The legs' inverse kinematics, for many postures at once."""

    def __init__(self, hips: Float, width: float, link: float) -> None:
        """Take the hips' positions (4, 3), the way from hip to thigh along y, and the length of thigh and calf [m]."""
        self.hips, self.width, self.link = hips, width, link
        self.lanes = hips[:, 1] + SIDE * width

    @classmethod
    def of(cls, model: Any) -> Legs:
        """Read them from MuJoCo's model."""
        hips = np.array([model.body(f"{prefix}_hip").pos for prefix in PREFIXES])
        return cls(hips, abs(model.body("FL_thigh").pos[1]), -model.body("FL_calf").pos[2])

    def joints(self, balls: Float) -> tuple[Float, Float]:
        """Joint angles (..., 4, 3), NaN out of reach, and knees (..., 4, 3) for balls of feet (..., 4, 3) in base."""
        p = balls - self.hips
        with np.errstate(invalid="ignore"):
            down = np.sqrt(p[..., 1] ** 2 + p[..., 2] ** 2 - self.width**2)
            roll = np.arctan2(p[..., 2], p[..., 1]) - np.arctan2(-down, SIDE * self.width)
            calf = -np.arccos((p[..., 0] ** 2 + down**2) / (2 * self.link**2) - 1)
        roll = (roll + np.pi) % (2 * np.pi) - np.pi
        thigh = np.arctan2(-p[..., 0], down) - calf / 2
        angles = np.stack((roll, thigh, calf), axis=-1)
        return angles, self.hips + self._turned(roll, -np.sin(thigh), -np.cos(thigh))

    def balls(self, joints: Float) -> Float:
        """Balls of the feet (4, 3) in base by joint angles (12,)."""
        roll, thigh, calf = joints.reshape(4, 3).T
        below = thigh + calf
        return self.hips + self._turned(roll, -np.sin(thigh) - np.sin(below), -np.cos(thigh) - np.cos(below))

    def _turned(self, roll: Float, x: Float, z: Float) -> Float:
        """From the hip: `width` aside, then x and z in link lengths in the plane of the leg, turned by its roll."""
        y, c, s = SIDE * self.width, np.cos(roll), np.sin(roll)
        return np.stack((self.link * x, c * y - s * self.link * z, s * y + c * self.link * z), axis=-1)
