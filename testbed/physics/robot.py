"""Go2 in MuJoCo, driven by torques: model, true state, and inverse kinematics of the legs.

Other robots derive from `Robot`.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from typing import Any

import numpy as np

from guara_perception.arrays import Float
from guara_perception.exceptions import optional_library
from guara_perception.simulation.world import World
from kinematics import RobotModel
from kinematics.transforms import transform_points
from testbed.physics.ground import add_ground
from testbed.physics.mujoco_robot import FRICTION, STEP_S, mujoco_robot
from testbed.stock_robots import stock_robot

LEGS = ("lf", "rf", "lh", "rh")
PREFIXES = ("FL", "FR", "RL", "RR")
SIDE = np.array([1.0, -1.0, 1.0, -1.0])
# Radius of a foot's ball, which replaces a cylinder of this radius in the stock URDF.
FOOT_RADIUS_M = 0.023
# Torque limits of hip, thigh and calf, which the URDF lacks [Nm].
TORQUE_LIMIT = np.array([23.7, 23.7, 45.43] * 4)
# Inertia of the rotors and viscous friction of the gears.
ARMATURE, DAMPING = 0.01, 0.1
# Gains of the position [1/s^2] and velocity [1/s] control of a swinging foot.
SWING_PULL, SWING_BRAKE = 1200.0, 60.0

go2 = partial(stock_robot, "go2")


class Robot:
    """Go2 on some ground; time passes only in `advance`. All state is the true state.

    Attributes:
        sole: length and width of a flat sole [m]; None = ball feet.
        heights: heights of the body above its feet, best first [m].
        clearance: clearance of a swinging foot [m].
        dry_friction: dry friction of a gear [Nm].
        start: x at which the body begins a course [m].
        slid: (4, 2) integrated horizontal motion of each foot since the start, including swings [m]; rolling of a ball
            does not count.
    """

    heights, torque_limit = (0.295, 0.27, 0.245), TORQUE_LIMIT
    clearance, dry_friction, start = 0.05, 0.2, 0.0
    sole: Float | None = None

    def __init__(self, world: World, start: float = 0.0, feet: Float | None = None) -> None:
        """Create the robot, standing level on level ground.

        Args:
            world: the ground.
            start: x at which the body begins [m].
            feet: (4, 2) positions of the feet in base_link [m]; None = below the hips.
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
        """Names of the bodies that touch the ground."""
        return [f"{prefix}_foot" for prefix in PREFIXES]

    def _prepare(self) -> None:
        """Read the parameters of the inverse kinematics from MuJoCo's model."""
        self.legs = Legs.of(self.model)

    def lanes(self) -> Float:
        """Positions (4, 2) of the feet below the hips, in base_link [m]."""
        return np.column_stack((self.legs.hips[:, 0], self.legs.lanes))

    def joints_at(self, feet: Float, base: Float, rotation: Float) -> Float:
        """Joint positions that place the feet at `feet` (4, 3) for a pose of the body [rad]; NaN if out of reach."""
        return self.legs.joints((feet + (0, 0, FOOT_RADIUS_M) - base) @ rotation)[0].ravel()

    @property
    def rotation(self) -> Float:
        """Attitude (3, 3) of the body in the world."""
        return np.array(self.data.xmat[self.body]).reshape(3, 3)

    @property
    def base(self) -> Float:
        """Position (3,) of the body in the world [m]."""
        return np.array(self.data.xpos[self.body])

    @property
    def transform_base_to_world(self) -> Float:
        """Pose (4, 4) of the body in the world."""
        transform = np.eye(4)
        transform[:3, :3], transform[:3, 3] = self.rotation, self.base
        return transform

    @property
    def com(self) -> Float:
        """Position (3,) of the centre of mass in the world [m]."""
        return np.array(self.data.subtree_com[self.body])

    @property
    def feet(self) -> Float:
        """Lowest points (4, 3) of the feet in the world [m]."""
        return np.asarray(self.data.xpos[self._feet] - (0, 0, FOOT_RADIUS_M))

    def feet_by(self, joints: Float, base: Float) -> Float:
        """Lowest points (4, 3) of the feet for joint positions [rad] and a pose (4, 4) of the body [m]."""
        return transform_points(base, self.legs.balls(joints)) - (0, 0, FOOT_RADIUS_M)

    @property
    def joint_positions(self) -> Float:
        """Joint positions in the order of `joint_names` [rad]."""
        return np.array(self.data.qpos[self._positions])

    @property
    def joints(self) -> dict[str, float]:
        """Joint positions by name [rad]."""
        return dict(zip(self.joint_names, self.joint_positions.tolist(), strict=True))

    @property
    def joint_speeds(self) -> Float:
        """Joint velocities in the order of `joint_names` [rad/s]."""
        return np.array(self.data.qvel[self.dofs])

    @property
    def turn_rate(self) -> Float:
        """Angular velocity (3,) of the body in the world [rad/s]."""
        return self.rotation @ np.array(self.data.qvel[3:6])

    def moving(self, leg: int, place: Float, velocity: Float, acceleration: Float) -> Float:
        """Torques of all joints that make a swinging foot follow a position, velocity and acceleration [Nm]."""
        joints, torques = slice(3 * leg, 3 * leg + 3), np.zeros(len(self.dofs))
        jacobian, dofs = self.jacobian(leg), self.dofs[joints]
        slow = velocity - jacobian @ self.data.qvel
        wanted = acceleration + SWING_PULL * (place - self.feet[leg]) + SWING_BRAKE * slow
        inertia = self.mass_matrix()[np.ix_(dofs, dofs)]
        torques[joints] = inertia @ np.linalg.solve(jacobian[:, dofs], wanted)
        return torques

    def levelling(self, legs: Iterable[int]) -> Float:
        """Torques of all joints that keep the soles of standing legs level [Nm]; zero for ball feet."""
        return np.zeros(len(self.dofs))

    def jacobian(self, leg: int) -> Float:
        """Jacobian (3, nv) of the position of a foot."""
        at, body = self.feet[leg], self._feet[leg]
        self._mujoco.mj_jac(self.model, self.data, self._jacobian, self._turn_jacobian, at, body)
        return self._jacobian.copy()

    def mass_matrix(self) -> Float:
        """Mass matrix (nv, nv)."""
        full = np.zeros((self.model.nv, self.model.nv))
        self._mujoco.mj_fullM(self.model, self.data, full)
        return full

    def load(self, leg: int) -> float:
        """Normal force of the ground on a foot [N]."""
        force, load = np.zeros(6), 0.0
        for i in range(self.data.ncon):
            geoms = self.data.contact[i].geom
            if self._feet[leg] in self.model.geom_bodyid[geoms]:
                self._mujoco.mj_contactForce(self.model, self.data, i, force)
                load += force[0]
        return load

    def advance(self, torques: Float, steps: int = 1) -> None:
        """Simulate a number of time steps with constant joint torques [Nm]."""
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
        """Replace the cylinders of the stock URDF by balls."""
        for name in self._foot_names():
            foot = spec.body(name)
            for geom in list(foot.geoms):
                spec.delete(geom)
            ball = self._mujoco.mjtGeom.mjGEOM_SPHERE
            foot.add_geom(type=ball, size=[FOOT_RADIUS_M, 0, 0], mass=0, friction=FRICTION)


class Legs:
    """Inverse kinematics of all legs."""

    def __init__(self, hips: Float, width: float, link: float) -> None:
        """Store positions (4, 3) of the hips, distance from hip to thigh along y, and length of thigh and calf [m]."""
        self.hips, self.width, self.link = hips, width, link
        self.lanes = hips[:, 1] + SIDE * width

    @classmethod
    def of(cls, model: Any) -> Legs:
        """Read the dimensions from MuJoCo's model."""
        hips = np.array([model.body(f"{prefix}_hip").pos for prefix in PREFIXES])
        return cls(hips, abs(model.body("FL_thigh").pos[1]), -model.body("FL_calf").pos[2])

    def joints(self, balls: Float) -> tuple[Float, Float]:
        """Compute joint angles (..., 4, 3) and knees (..., 4, 3) for balls of feet (..., 4, 3) in base_link.

        Angles are NaN if a foot is out of reach.
        """
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
        """Compute the balls (4, 3) of the feet in base_link from joint angles (12,)."""
        roll, thigh, calf = joints.reshape(4, 3).T
        below = thigh + calf
        return self.hips + self._turned(roll, -np.sin(thigh) - np.sin(below), -np.cos(thigh) - np.cos(below))

    def _turned(self, roll: Float, x: Float, z: Float) -> Float:
        """Offsets from the hips of points in the planes of the legs, rotated by the roll angles.

        The points are `width` beside the hips; `x` and `z` are their coordinates in units of the link length.
        """
        y, c, s = SIDE * self.width, np.cos(roll), np.sin(roll)
        return np.stack((self.link * x, c * y - s * self.link * z, s * y + c * self.link * z), axis=-1)
