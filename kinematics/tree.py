"""Kinematic tree of a robot: Pinocchio's model of its URDF, with joints, limits and frames found by name.

This module hides that Pinocchio has its own order of joints and returns an index past the end for an unknown frame.
The body is a free-flyer held at the identity, so Pinocchio's world is `base_link`.

Pinocchio's own URDF reader is not used: it gives a continuous joint two coordinates and fails if a link and a joint
share a name. Only links get frames here, so every name is unique.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from kinematics.arrays import Float, read_only
from kinematics.exceptions import RobotFileError, named
from kinematics.robot_toml import LegConfig, RobotToml
from kinematics.urdf import Joint, Link, Urdf
from kinematics.urdf_checks import root_link


class KinematicTree:
    """Pinocchio model of a checked URDF, indexed by name.

    Attributes:
        urdf: content of the URDF.
        config: content of robot.toml.
        joint_names: all moving joints: those of the legs, from hip to sole in robot.toml's order, then any others.
        legs: leg name -> its configuration, in robot.toml's order.
        links: link name -> its inertia and shapes.
        lower_limits, upper_limits: (n,) [rad], in the order of `joint_names`.
        pinocchio_model: Pinocchio's model; do not modify it.
        velocity_indices: (n,) columns of Pinocchio's Jacobians, in the order of `joint_names`.
        nominal: (n,) joint positions of a standing posture, in the order of `joint_names`; defines the side to which
            the knees bend.
    """

    def __init__(self, urdf: Urdf, config: RobotToml, nominal: Mapping[str, float] | None = None) -> None:
        """Build Pinocchio's model and the maps from names to its indices.

        Args:
            urdf: content of the URDF.
            config: content of robot.toml; its links and joints are in the URDF.
            nominal: joint name -> position [rad] of a standing posture; None = midway between the limits.

        Raises:
            RobotFileError: Pinocchio rejects the URDF.
        """
        import pinocchio

        self.urdf = urdf
        self.config = config
        self.legs: Mapping[str, LegConfig] = MappingProxyType({leg.name: leg for leg in config.legs})
        self.links: Mapping[str, Link] = MappingProxyType({link.name: link for link in urdf.links})
        moving = {joint.name: joint for joint in urdf.joints if joint.kind != "fixed"}
        leg_joints = [joint for leg in config.legs for joint in leg.joints]
        self.joint_names = (*leg_joints, *(name for name in moving if name not in leg_joints))
        self._columns = {name: column for column, name in enumerate(self.joint_names)}
        self.lower_limits = read_only(np.array([moving[name].lower for name in self.joint_names], np.float64))
        self.upper_limits = read_only(np.array([moving[name].upper for name in self.joint_names], np.float64))
        centre = (self.lower_limits + self.upper_limits) / 2.0
        self.nominal = (
            centre if nominal is None else read_only(np.array([nominal[name] for name in self.joint_names], np.float64))
        )
        try:
            self.pinocchio_model: Any = build_model(urdf)
        except (ValueError, RuntimeError) as error:
            raise RobotFileError(f"{urdf.path}: Pinocchio refuses it: {error}") from error
        joints = [self.pinocchio_model.joints[self.pinocchio_model.getJointId(name)] for name in self.joint_names]
        self._position_indices = np.array([joint.idx_q for joint in joints])
        self.velocity_indices = np.array([joint.idx_v for joint in joints])
        self._neutral = pinocchio.neutral(self.pinocchio_model)
        self._frame_ids = {
            name: int(self.pinocchio_model.getFrameId(name, pinocchio.FrameType.BODY)) for name in self.links
        }

    def configuration(self, positions: Float) -> Float:
        """Pinocchio's configuration vector for joint positions (n,) in the order of `joint_names`."""
        configuration = self._neutral.copy()
        configuration[self._position_indices] = positions
        return configuration

    def frame_id(self, frame: str) -> int:
        """Pinocchio's index of a link's frame.

        Raises:
            UnknownName: the robot has no such frame; the message lists them.
        """
        return named("frame", frame, self._frame_ids)

    def leg(self, leg: str) -> LegConfig:
        """Configuration of a leg.

        Raises:
            UnknownName: the robot has no such leg; the message lists them.
        """
        return named("leg", leg, self.legs)

    def joint_index(self, joint: str) -> int:
        """Index of a joint in `joint_names`.

        Raises:
            UnknownName: the robot has no such joint; the message lists them.
        """
        return named("joint", joint, self._columns)


def build_model(urdf: Urdf, only: tuple[str, ...] | None = None) -> Any:
    """Build a `pinocchio.Model` with a BODY frame for every link.

    Args:
        urdf: a URDF that passed `check_urdf`.
        only: joints that move, on a fixed base; None = all of them, on a free-flyer `root_joint`.

    Raises:
        ValueError, RuntimeError: Pinocchio rejects a value.
    """
    import pinocchio

    model = pinocchio.Model()
    model.name = urdf.name
    below: dict[str, list[Joint]] = {}
    for joint in urdf.joints:
        below.setdefault(joint.parent, []).append(joint)
    links = {link.name: link for link in urdf.links}
    first = 0
    if only is None:
        first = model.addJoint(0, pinocchio.JointModelFreeFlyer(), pinocchio.SE3.Identity(), "root_joint")
    # Name of a link, index of the joint that carries it, and its pose in that joint's frame.
    open_links = [(root_link(urdf), first, pinocchio.SE3.Identity())]
    while open_links:
        name, carrier, placement = open_links.pop()
        link = links[name]
        if link.mass:
            inertia = pinocchio.Inertia(float(link.mass), link.centre_of_mass, link.inertia)
            model.appendBodyToJoint(carrier, inertia, placement)
        model.addFrame(pinocchio.Frame(name, carrier, placement, pinocchio.FrameType.BODY), False)
        for joint in reversed(below.get(name, [])):
            origin = placement * pinocchio.SE3(np.array(joint.transform_child_to_parent))
            if joint.kind == "fixed" or (only is not None and joint.name not in only):
                open_links.append((joint.child, carrier, origin))
                continue
            number = model.addJoint(carrier, _joint_model(joint), origin, joint.name)
            index = model.joints[number].idx_q
            model.lowerPositionLimit[index], model.upperPositionLimit[index] = joint.lower, joint.upper
            open_links.append((joint.child, number, pinocchio.SE3.Identity()))
    return model


def _joint_model(joint: Joint) -> Any:
    import pinocchio

    axis = joint.axis / np.linalg.norm(joint.axis)
    for index, letter in enumerate("XYZ"):
        if axis[index] == 1.0:
            return getattr(pinocchio, f"JointModel{'P' if joint.kind == 'prismatic' else 'R'}{letter}")()
    if joint.kind == "prismatic":
        return pinocchio.JointModelPrismaticUnaligned(axis)
    return pinocchio.JointModelRevoluteUnaligned(axis)
