"""The Go2 in MuJoCo, driven by torques: its model, true state and the inverse kinematics of its legs."""

from __future__ import annotations

import tempfile
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from guara_perception.app.robot_folder.new_robot import new_robot
from guara_perception.arrays import Float
from guara_perception.exceptions import optional_library
from guara_perception.simulation.features import Pit
from kinematics import RobotModel, load_robot
from testbed.crossing.courses import Block, Course
from testbed.physics.mujoco_robot import FRICTION, mujoco_robot
from testbed.stock_robots import stock_urdf

LEGS = ("lf", "rf", "lh", "rh")
PREFIXES = ("FL", "FR", "RL", "RR")
SIDE = np.array([1.0, -1.0, 1.0, -1.0])
# The ball of a foot; the stock URDF has a cylinder of this radius there.
FOOT_RADIUS_M = 0.023
# Stock values of hip, thigh and calf, which the URDF lacks [Nm].
TORQUE_LIMIT = np.array([23.7, 23.7, 45.43] * 4)
# Inertia of the rotors; viscous and dry friction of the gears.
ARMATURE, DAMPING, DRY_FRICTION = 0.01, 0.1, 0.2
ROBOT_BIT, GROUND_BIT = 1, 2


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
    """A Go2 on a course; time goes on in `advance` alone. All that it tells is true."""

    def __init__(self, course: Course, base: Float) -> None:
        """Build it, level, its feet on the ground below the hips.

        Args:
            course: the ground.
            base: position (3,) of the body [m].
        """
        self._mujoco = optional_library("mujoco", "sim", "a crossing")
        self.product = go2()
        self.model = self._build(course)
        self.data: Any = self._mujoco.MjData(self.model)
        model = self.model
        self.body = model.body("base").id
        self.mass = float(model.body_subtreemass[self.body])
        self._feet = [model.body(f"{prefix}_foot").id for prefix in PREFIXES]
        names = [f"{prefix}_{part}_joint" for prefix in PREFIXES for part in ("hip", "thigh", "calf")]
        self.joint_names = names
        self._positions = np.array([model.joint(name).qposadr[0] for name in names])
        self.dofs = np.array([model.joint(name).dofadr[0] for name in names])
        self.legs = Legs.of(model)
        self.data.qpos[:3] = base
        feet = np.column_stack((self.legs.hips[:, 0], self.legs.lanes, np.full(4, FOOT_RADIUS_M)))
        self.data.qpos[self._positions] = self.legs.joints(feet - (0, 0, base[2]))[0].ravel()
        self._jacobian, self._turn_jacobian = np.zeros((3, model.nv)), np.zeros((3, model.nv))
        self._mujoco.mj_forward(model, self.data)
        self._mujoco.mj_subtreeVel(model, self.data)
        self.com_in_base = self.rotation.T @ (self.com - self.base)

    @property
    def rotation(self) -> Float:
        """Attitude of the body, (3, 3)."""
        return np.array(self.data.xmat[self.body]).reshape(3, 3)

    @property
    def base(self) -> Float:
        """Position of the body (3,) [m]."""
        return np.array(self.data.xpos[self.body])

    @property
    def com(self) -> Float:
        """Centre of mass (3,) [m]."""
        return np.array(self.data.subtree_com[self.body])

    @property
    def feet(self) -> Float:
        """Lowest points of the feet (4, 3) [m]."""
        return np.asarray(self.data.xpos[self._feet] - (0, 0, FOOT_RADIUS_M))

    @property
    def joint_positions(self) -> Float:
        """(12,) [rad], in the order of `joint_names`."""
        return np.array(self.data.qpos[self._positions])

    @property
    def joint_speeds(self) -> Float:
        """(12,) [rad/s]."""
        return np.array(self.data.qvel[self.dofs])

    @property
    def turn_rate(self) -> Float:
        """Of the body, in the world (3,) [rad/s]."""
        return self.rotation @ np.array(self.data.qvel[3:6])

    def jacobian(self, leg: int) -> Float:
        """Velocity of the lowest point of a foot by all velocities, (3, nv)."""
        point = self.data.xpos[self._feet[leg]] - (0, 0, FOOT_RADIUS_M)
        self._mujoco.mj_jac(self.model, self.data, self._jacobian, self._turn_jacobian, point, self._feet[leg])
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
        """Let time go on under these joint torques (12,) [Nm]."""
        self.data.ctrl[:] = np.clip(torques, -TORQUE_LIMIT, TORQUE_LIMIT)
        self._mujoco.mj_step(self.model, self.data, steps)
        self._mujoco.mj_subtreeVel(self.model, self.data)

    def _build(self, course: Course) -> Any:
        mujoco = self._mujoco
        spec = mujoco_robot(self.product)
        for servo in list(spec.actuators):
            spec.delete(servo)
        for prefix in PREFIXES:
            foot = spec.body(f"{prefix}_foot")
            for geom in list(foot.geoms):
                spec.delete(geom)
            foot.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[FOOT_RADIUS_M, 0, 0], mass=0, friction=FRICTION)
            for part in ("hip", "thigh", "calf"):
                name = f"{prefix}_{part}_joint"
                joint = spec.joint(name)
                joint.armature, joint.damping, joint.frictionloss = ARMATURE, np.r_[DAMPING, 0, 0], DRY_FRICTION
                spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT).set_to_motor()
        for geom in spec.geoms:  # It touches the ground, never itself.
            geom.contype, geom.conaffinity = ROBOT_BIT, GROUND_BIT
        _add_ground(spec, course, mujoco)
        return spec.compile()


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


def _add_ground(spec: Any, course: Course, mujoco: Any) -> None:
    """Solid ground: blocks as boxes, what is left of a floor with pits as boxes between their edges."""
    common = {"contype": GROUND_BIT, "conaffinity": ROBOT_BIT, "friction": FRICTION}
    world = course.world
    pits = [each for each in world.features if isinstance(each, Pit)]
    floor = -max([each.depth for each in pits], default=0.0)
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 0.05], pos=[0, 0, floor], **common)
    boxes = [(each.x, each.y, *each.size, each.yaw, each.top) for each in world.features if isinstance(each, Block)]
    boxes += [((x0 + x1) / 2, (y0 + y1) / 2, x1 - x0, y1 - y0, 0.0, 0.0) for x0, x1, y0, y1 in _between(world, pits)]
    for x, y, length, width, yaw, top in boxes:
        half = (top - floor + 0.05) / 2
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=[length / 2, width / 2, half],
            pos=[x, y, top - half],
            quat=[np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)],
            **common,
        )


def _between(world: Any, pits: list[Pit]) -> list[tuple[float, float, float, float]]:
    """Rectangles of the world that no pit covers: lowest and highest x and y."""
    rectangles = [(world.x[0] - 1, world.x[1] + 1, world.y[0] - 1, world.y[1] + 1)] if pits else []
    for pit in pits:
        a0, a1, b0, b1 = pit.bounds
        cut = []
        for x0, x1, y0, y1 in rectangles:
            low, high, near, far = max(x0, a0), min(x1, a1), max(y0, b0), min(y1, b1)
            if low >= high or near >= far:
                cut.append((x0, x1, y0, y1))
                continue
            parts = ((x0, low, y0, y1), (high, x1, y0, y1), (low, high, y0, near), (low, high, far, y1))
            cut += [each for each in parts if each[0] < each[1] and each[2] < each[3]]
        rectangles = cut
    return rectangles
