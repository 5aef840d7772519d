"""Guará in MuJoCo, driven by torques, with flat soles that ankles keep level in pitch and passive hinges in roll."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from guara_perception.arrays import Float
from kinematics import RobotModel, load_robot
from kinematics.transforms import transform_points
from testbed.physics.mujoco_robot import FRICTION
from testbed.physics.robot import LEGS, SWING_BRAKE, SWING_PULL, Robot

# Each sole can roll on a passive hinge along its middle, because no joint of a leg rolls it. Without the hinge, the
# sole of an inclined leg would stand on an edge, with its middle up to 9 mm above the ground, which the stance pose of
# the package does not model.
SOLE_THICKNESS_M, SOLE_KG, SOLE_ARMATURE, SOLE_DAMPING, SOLE_STIFFNESS = 0.020, 0.02, 0.001, 0.05, 0.5
LEVEL_PULL, LEVEL_BRAKE = 40.0, 2.0
# Time over which joint velocities of a swinging leg are computed.
AHEAD_S = 0.001


class Guara(Robot):
    """Guará on a course."""

    heights, torque_limit = (0.36, 0.33, 0.30), np.full(16, 40.0)
    sole = np.array([0.080, 0.060])
    # The camera looks steeply down, so the upper bounds of height over a gap are low only if the gap was first seen at
    # the far end of the scanned area; a swinging leg can be folded by 0.11 m. The friction is assumed: 0.2 Nm, as in
    # the gears of a Go2, would support a quarter of the body's weight with nearly straight legs.
    clearance, dry_friction, start = 0.03, 0.05, -0.25

    def _product(self) -> RobotModel:
        return load_robot("guara")

    def _foot_names(self) -> list[str]:
        return [f"{leg}_flat" for leg in LEGS]

    def _prepare(self) -> None:
        self._soles = [self.model.body(self.product.tree.leg(leg).sole).id for leg in LEGS]

    def lanes(self) -> Float:
        """See `Robot`."""
        return self.product.state(self.product.posture(self.product.config.scan_posture)).soles_in_base()[:, :2]

    def joints_at(self, feet: Float, base: Float, rotation: Float) -> Float:
        """See `Robot`."""
        return np.concatenate([self._reached(leg, foot, base, rotation) for leg, foot in enumerate(feet)])

    def _reached(self, leg: int, soles: Float, base: Float, rotation: Float) -> Float:
        body = np.eye(4)
        body[:3, :3], body[:3, 3] = rotation, base
        return self.product.reach_from(LEGS[leg], soles, body).joint_positions

    def _make_feet(self, spec: Any) -> None:
        """Replace the soles of the URDF by boxes, each on a hinge along its middle."""
        mujoco = self._mujoco
        half = [*self.sole / 2, SOLE_THICKNESS_M / 2]
        for leg in LEGS:
            foot = spec.body(f"{leg}_foot_link")
            for geom in list(foot.geoms):
                spec.delete(geom)
            sole = foot.add_body(name=f"{leg}_flat", pos=spec.body(self.product.tree.leg(leg).sole).pos)
            hinge = sole.add_joint(type=mujoco.mjtJoint.mjJNT_HINGE, axis=[1, 0, 0])
            hinge.armature, hinge.damping, hinge.stiffness = (
                SOLE_ARMATURE,
                np.r_[SOLE_DAMPING, 0, 0],
                np.r_[SOLE_STIFFNESS, 0, 0],
            )
            sole.add_geom(
                type=mujoco.mjtGeom.mjGEOM_BOX, size=half, pos=[0, 0, half[2]], mass=SOLE_KG, friction=FRICTION
            )

    @property
    def feet(self) -> Float:
        """Centres (4, 3) of the soles in the world [m]."""
        return np.array(self.data.xpos[self._soles])

    def feet_by(self, joints: Float, base: Float) -> Float:
        """See `Robot`."""
        positions = dict(zip(self.joint_names, joints.tolist(), strict=True))
        return transform_points(base, self.product.state(positions).soles_in_base())

    def moving(self, leg: int, place: Float, velocity: Float, acceleration: Float) -> Float:
        """See `Robot`; the leg is position-controlled, because force control fails with a nearly straight knee."""
        joints, torques = slice(4 * leg, 4 * leg + 4), np.zeros(len(self.dofs))
        places = np.array([place, place + velocity * AHEAD_S])
        wanted, soon = self._reached(leg, places, self.base, self.rotation)
        slow = (soon - wanted) / AHEAD_S - self.joint_speeds[joints]
        # A leg that cannot reach the position is not moved.
        pulled = np.nan_to_num(SWING_PULL * (wanted - self.joint_positions[joints])) + np.nan_to_num(SWING_BRAKE * slow)
        dofs = self.dofs[joints]
        torques[joints] = self.mass_matrix()[np.ix_(dofs, dofs)] @ pulled
        return torques

    def levelling(self, legs: Iterable[int]) -> Float:
        """See `Robot`."""
        torques = np.zeros(len(self.dofs))
        for leg in legs:
            # Pitch of the sole in the world, positive if the toe is down.
            pitch = np.arcsin(np.clip(-self.data.xmat[self._soles[leg]].reshape(3, 3)[2, 0], -1.0, 1.0))
            ankle = 4 * leg + 3
            torques[ankle] = -LEVEL_PULL * pitch - LEVEL_BRAKE * self.data.qvel[self.dofs[ankle]]
        return torques


ROBOTS: dict[str, type[Robot]] = {"go2": Robot, "guara": Guara}
