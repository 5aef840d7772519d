"""Kinematic tree of a robot: Pinocchio's model of its URDF, and its states with the poses of all links.

This module hides two peculiarities of Pinocchio: it has its own order of joints, and it returns an index past the end
for an unknown frame. The body is a free-flyer held at the identity, so Pinocchio's world frame is `base_link`.

Pinocchio's own URDF reader is not used, because it gives a continuous joint two coordinates and fails if a link and a
joint share a name. Here only links have frames, so every frame name is unique.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt

from kinematics.arrays import Float, read_only
from kinematics.exceptions import JointLimitWarning, JointPositionError, RobotFileError, named, unknown_name
from kinematics.robot_toml import LegConfig, RobotToml
from kinematics.urdf import Joint, Link, Urdf
from kinematics.urdf_checks import root_link

# Tolerance of joint limits [rad or m]: a position exactly at a limit is not beyond it.
LIMIT_TOLERANCE = 1e-9
# Noise, limits and speeds given in radians are multiplied by this for prismatic joints [m/rad]; a revolute joint of a
# leg moves the foot by about this distance per radian.
LEVER_M = 0.2
# Number of joints named in one warning; further ones are only counted.
NAMED = 3


class KinematicTree:
    """Pinocchio model of a checked URDF, indexed by name.

    Attributes:
        urdf: content of the URDF.
        config: content of robot.toml.
        joint_names: all moving joints: those of the legs, from hip to sole in robot.toml's order, then any others.
        legs: leg name -> configuration of the leg, in robot.toml's order.
        links: link name -> the link with its inertia and shapes.
        lower_limits, upper_limits: (n,) [rad], for prismatic joints [m], in the order of `joint_names`.
        is_prismatic: (n,) mask of the prismatic joints.
        joint_scales: (n,) factors that convert noise, limits and speeds from radians to the unit of each joint: 1, for
            prismatic joints `LEVER_M` [m/rad].
        pinocchio_model: Pinocchio's model; do not modify it.
        velocity_indices: (n,) columns of Pinocchio's Jacobians, in the order of `joint_names`.
        nominal: (n,) joint positions of a standing posture, in the order of `joint_names`; defines the side to which
            the knees bend.
    """

    def __init__(self, urdf: Urdf, config: RobotToml, nominal: Mapping[str, float] | None = None) -> None:
        """Build Pinocchio's model and the maps from names to its indices.

        Args:
            urdf: content of the URDF.
            config: content of robot.toml; the URDF must contain the links and joints that it names.
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
        self.is_prismatic = read_only(np.array([moving[name].kind == "prismatic" for name in self.joint_names], bool))
        self.joint_scales = read_only(np.where(self.is_prismatic, LEVER_M, 1.0))
        self.lower_limits = read_only(np.array([moving[name].lower for name in self.joint_names], np.float64))
        self.upper_limits = read_only(np.array([moving[name].upper for name in self.joint_names], np.float64))
        centre = (self.lower_limits + self.upper_limits) / 2.0
        self.nominal = (
            centre if nominal is None else read_only(np.array([nominal[name] for name in self.joint_names], np.float64))
        )
        try:
            self.pinocchio_model: Any = build_model(urdf)
        except (ValueError, RuntimeError) as error:
            raise RobotFileError(f"{urdf.path}: Pinocchio rejects it: {error}") from error
        joints = [self.pinocchio_model.joints[self.pinocchio_model.getJointId(name)] for name in self.joint_names]
        self._position_indices = np.array([joint.idx_q for joint in joints])
        self.velocity_indices = np.array([joint.idx_v for joint in joints])
        self._neutral = pinocchio.neutral(self.pinocchio_model)
        self._frame_ids = {
            name: int(self.pinocchio_model.getFrameId(name, pinocchio.FrameType.BODY)) for name in self.links
        }

    def configuration(self, positions: Float) -> Float:
        """Convert joint positions (n,) in the order of `joint_names` to Pinocchio's configuration vector."""
        configuration = self._neutral.copy()
        configuration[self._position_indices] = positions
        return configuration

    def frame_id(self, frame: str) -> int:
        """Pinocchio's index of a link's frame.

        Raises:
            UnknownName: the robot has no such frame; the message lists the known ones.
        """
        return named("frame", frame, self._frame_ids)

    def leg(self, leg: str) -> LegConfig:
        """Configuration of a leg.

        Raises:
            UnknownName: the robot has no such leg; the message lists the known ones.
        """
        return named("leg", leg, self.legs)

    def unit(self, index: int) -> str:
        """Unit of a joint's position."""
        return "m" if self.is_prismatic[index] else "rad"

    def joint_index(self, joint: str) -> int:
        """Index of a joint in `joint_names`.

        Raises:
            UnknownName: the robot has no such joint; the message lists the known ones.
        """
        return named("joint", joint, self._columns)


def build_model(urdf: Urdf, only: tuple[str, ...] | None = None) -> Any:
    """Build a `pinocchio.Model` with a BODY frame for every link.

    Args:
        urdf: a URDF that passed `check_urdf`.
        only: joints that move, on a fixed base, with all others fixed at zero; None = all joints move, on a free-flyer
            `root_joint`.

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
    # Name of a link, index of the joint that carries the link, and pose of the link in that joint's frame.
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


class RobotState:
    """Poses of all links of the robot for one set of joint positions; immutable.

    Args:
        tree: the robot's kinematic tree.
        joint_positions: joint name -> position [rad], every joint once; or (n,) in the order of `tree.joint_names`.

    Attributes:
        tree: the robot's kinematic tree.
        positions: (n,) joint positions [rad], of prismatic joints [m], in the order of `tree.joint_names`; read-only.
        beyond_limits: joint name -> distance beyond its limits [rad], of prismatic joints [m]; empty if all joints are
            within their limits.

    Raises:
        UnknownName: a joint that the robot does not have.
        JointPositionError: a joint is missing, a value is not a finite number or obviously not in radians, or an array
            has the wrong length.

    Warns:
        JointLimitWarning: joints are beyond their limits.
    """

    def __init__(self, tree: KinematicTree, joint_positions: Mapping[str, float] | npt.ArrayLike) -> None:
        """Check the positions and run forward kinematics once."""
        import pinocchio

        self.tree = tree
        self.positions = read_only(checked_positions(tree, joint_positions))
        self.beyond_limits: Mapping[str, float] = MappingProxyType(beyond_limits(tree, self.positions))
        self._data = tree.pinocchio_model.createData()
        pinocchio.framesForwardKinematics(tree.pinocchio_model, self._data, tree.configuration(self.positions))
        pinocchio.computeJointJacobians(tree.pinocchio_model, self._data)

    @property
    def joint_positions(self) -> Mapping[str, float]:
        """Joint name -> position [rad], of a prismatic joint [m]; read-only."""
        return MappingProxyType(dict(zip(self.tree.joint_names, self.positions.tolist(), strict=True)))

    def transform_to_base(self, frame: str) -> Float:
        """`transform_<frame>_to_base`, (4, 4), read-only.

        Raises:
            UnknownName: the robot has no such frame; the message lists the known ones.
        """
        # `homogeneous` is a copy: the placement itself is a live view of Pinocchio's data.
        return read_only(self._data.oMf[self.tree.frame_id(frame)].homogeneous)

    def position_in_base(self, frame: str) -> Float:
        """Origin of a frame in `base_link`, (3,) [m], read-only; raises as `transform_to_base`."""
        return read_only(self._data.oMf[self.tree.frame_id(frame)].translation)

    def soles_in_base(self, legs: Iterable[str] | None = None) -> Float:
        """Sole centres in `base_link`, (n, 3) [m], in the order of `legs`; None = all legs.

        For a round foot, x and y are those of the sole frame, and z is that of the lowest point of the ball along base
        z. When the ball rolls, this point stays in place to within 0.2 mm, while the frame rises.

        Raises:
            UnknownName: a leg that the robot does not have.
        """
        names = tuple(self.tree.legs) if legs is None else tuple(legs)
        places = [self._data.oMf[self.tree.frame_id(self.tree.leg(leg).sole)] for leg in names]
        soles = np.reshape([place.translation for place in places], (-1, 3))
        if radius := self.tree.config.sole_radius:
            soles[:, 2] -= [radius * (1.0 - place.rotation[2, 2]) for place in places]
        return read_only(soles)

    def jacobian(self, frame: str) -> Float:
        """Jacobian (6, n) of a frame with the body fixed: linear rows [m/rad], then angular rows [rad/rad].

        Rows are along the axes of `base_link`, columns in the order of `tree.joint_names`.

        Raises:
            UnknownName: the robot has no such frame; the message lists the known ones.
        """
        import pinocchio

        jacobian = pinocchio.getFrameJacobian(
            self.tree.pinocchio_model,
            self._data,
            self.tree.frame_id(frame),
            pinocchio.ReferenceFrame.LOCAL_WORLD_ALIGNED,
        )
        return read_only(jacobian[:, self.tree.velocity_indices])

    def noise_jacobian(self, frame: str) -> Float:
        """`jacobian` per radian of noise: columns of prismatic joints are multiplied by `tree.joint_scales`."""
        return read_only(self.jacobian(frame) * self.tree.joint_scales)

    @property
    def centre_of_mass_in_base(self) -> Float:
        """Centre of mass of the whole robot in `base_link`, (3,) [m]."""
        import pinocchio

        # Uses the placements computed in the constructor and leaves them unchanged.
        return read_only(pinocchio.centerOfMass(self.tree.pinocchio_model, self._data, False))


def checked_positions(tree: KinematicTree, joint_positions: Mapping[str, float] | npt.ArrayLike) -> Float:
    """Check joint positions and return them as an array (n,) in the order of `tree.joint_names`.

    Args:
        tree: the kinematic tree that names the joints.
        joint_positions: joint name -> position, every joint once; or an array in the order of `tree.joint_names`.

    Raises:
        UnknownName: a joint that the robot does not have.
        JointPositionError: a joint is missing, a value is not a finite number or obviously not in radians, or an array
            has the wrong length.
    """
    names = tree.joint_names
    values = in_order(joint_positions, names, "position") if isinstance(joint_positions, Mapping) else joint_positions
    try:
        positions = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise JointPositionError(f"joint positions are not numbers: {values!r}") from None
    if positions.shape != (len(names),):
        raise JointPositionError(
            f"joint positions have shape {positions.shape}; ({len(names)},) is needed, in the order {', '.join(names)}"
        )
    refuse_not_finite(positions, names, "position")
    _refuse_other_units(tree, positions)
    return positions


def in_order(values: Mapping[str, float], names: Sequence[str], kind: str) -> list[float]:
    """Values of all joints in the order of `names`.

    Args:
        values: joint name -> value, every joint once.
        names: names of all joints.
        kind: quantity named in messages, "position" or "velocity".

    Raises:
        UnknownName: a joint that the robot does not have.
        JointPositionError: a joint is missing.
    """
    for name in values:
        if name not in names:
            raise unknown_name("joint", name, names)
    missing = [name for name in names if name not in values]
    if missing:
        raise JointPositionError(f"no {kind} for {', '.join(missing)}; all {len(names)} joints are needed")
    return [values[name] for name in names]


def refuse_not_finite(values: Float, names: Sequence[str], kind: str) -> None:
    """Check that all values are finite; arguments as in `in_order`.

    Raises:
        JointPositionError: a value is not finite.
    """
    for name, value in zip(names, values, strict=True):
        if not np.isfinite(value):
            raise JointPositionError(f"joint {name}: {kind} {value} is not finite")


def _refuse_other_units(tree: KinematicTree, positions: Float) -> None:
    """Reject a position more than half a turn beyond the limits of a revolute joint: it is not in radians.

    Joints whose limits span a full turn or more are not checked.
    """
    lower, upper = tree.lower_limits, tree.upper_limits
    far = (positions < lower - np.pi) | (positions > upper + np.pi)
    for index in np.flatnonzero(far & ~tree.is_prismatic & (upper - lower < 2.0 * np.pi)).tolist():
        value = positions[index]
        raise JointPositionError(
            f"joint {tree.joint_names[index]} is at {value:g} rad, half a turn or more beyond its limits "
            f"{lower[index]:g} ... {upper[index]:g}; positions are in radians ({value:g} degrees are "
            f"{np.radians(value):.4f} rad)"
        )


def beyond_limits(tree: KinematicTree, positions: Float) -> dict[str, float]:
    """Distance beyond its limits [rad], of prismatic joints [m], for each joint that exceeds them.

    One `JointLimitWarning` is issued for all. Such positions are accepted, because encoders have offsets and the limits
    in a URDF are nominal.
    """
    beyond: dict[str, float] = {}
    complaints = []
    lower, upper = tree.lower_limits, tree.upper_limits
    outside = (positions < lower - LIMIT_TOLERANCE) | (positions > upper + LIMIT_TOLERANCE)
    for index in np.flatnonzero(outside).tolist():
        name, value = tree.joint_names[index], positions[index]
        beyond[name] = float(max(lower[index] - value, value - upper[index]))
        unit = tree.unit(index)
        complaints.append(
            f"joint {name} is at {value:.4f} {unit}, {beyond[name]:.4f} {unit} beyond its limits "
            f"{lower[index]:g} ... {upper[index]:g}"
        )
    if complaints:
        further = len(complaints) - NAMED
        more = f"; and {further} more joint{'s' * (further > 1)}" if further > 0 else ""
        warnings.warn(
            "; ".join(complaints[:NAMED]) + more,
            JointLimitWarning,
            stacklevel=4,  # the caller of RobotModel.state
        )
    return beyond
