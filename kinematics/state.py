"""State of the robot: checked joint positions, and the poses of all links by forward kinematics."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType

import numpy as np
import numpy.typing as npt

from kinematics.arrays import Float, read_only
from kinematics.exceptions import JointLimitWarning, JointPositionError, unknown_name
from kinematics.tree import KinematicTree

# Tolerance of joint limits [rad]: a position exactly at a limit is not beyond it.
LIMIT_TOLERANCE = 1e-9
# Number of joints named in one warning; the others are counted.
NAMED = 3


class RobotState:
    """Poses of all links of the robot for one set of joint positions; immutable.

    Args:
        tree: the robot's kinematic tree.
        joint_positions: joint name -> position [rad], every joint once; or (n,) in the order of `tree.joint_names`.

    Attributes:
        tree: the robot's kinematic tree.
        positions: (n,) joint positions [rad] in the order of `tree.joint_names`, read-only.
        beyond_limits: joint name -> distance beyond its limit [rad]; empty if all are within.

    Raises:
        UnknownName: a joint that the robot does not have.
        JointPositionError: a joint is missing, a value is not finite, or an array has the wrong length.
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
        """Joint name -> position [rad], read-only."""
        return MappingProxyType(dict(zip(self.tree.joint_names, self.positions.tolist(), strict=True)))

    def transform_to_base(self, frame: str) -> Float:
        """`transform_<frame>_to_base`, (4, 4), read-only.

        Raises:
            UnknownName: the robot has no such frame; the message lists them.
        """
        # `homogeneous` is a copy: the placement itself is a live view of Pinocchio's data.
        return read_only(self._data.oMf[self.tree.frame_id(frame)].homogeneous)

    def position_in_base(self, frame: str) -> Float:
        """Origin of a frame in `base_link`, (3,) [m], read-only; `UnknownName` as above."""
        return read_only(self._data.oMf[self.tree.frame_id(frame)].translation)

    def soles_in_base(self, legs: Iterable[str] | None = None) -> Float:
        """Sole centres in `base_link`, (n, 3) [m], in the order of `legs` (default: all legs)."""
        names = tuple(self.tree.legs) if legs is None else tuple(legs)
        frames = [self.tree.frame_id(self.tree.leg(leg).sole) for leg in names]
        return read_only(np.reshape([self._data.oMf[frame].translation for frame in frames], (-1, 3)))

    def jacobian(self, frame: str) -> Float:
        """Jacobian of a frame's origin, (6, n): d(linear [m], angular [rad]) / d(positions).

        Axes of `base_link`, with the body fixed; columns in the order of `tree.joint_names`.
        """
        import pinocchio

        jacobian = pinocchio.getFrameJacobian(
            self.tree.pinocchio_model,
            self._data,
            self.tree.frame_id(frame),
            pinocchio.ReferenceFrame.LOCAL_WORLD_ALIGNED,
        )
        return read_only(jacobian[:, self.tree.velocity_indices])

    @property
    def centre_of_mass_in_base(self) -> Float:
        """Centre of mass of the whole robot in `base_link`, (3,) [m]."""
        import pinocchio

        # Uses the placements computed above; changes nothing else in the data.
        return read_only(pinocchio.centerOfMass(self.tree.pinocchio_model, self._data, False))


def checked_positions(tree: KinematicTree, joint_positions: Mapping[str, float] | npt.ArrayLike) -> Float:
    """Joint positions (n,) [rad] in the order of `tree.joint_names`.

    Args:
        tree: the kinematic tree that names the joints.
        joint_positions: joint name -> position, every joint once; or an array in the order of `tree.joint_names`.

    Raises:
        UnknownName: a joint that the robot does not have.
        JointPositionError: a joint is missing, a value is not a finite number or obviously not in radians, or an array
            has the wrong length.
    """
    names = tree.joint_names
    values = joint_positions
    if isinstance(joint_positions, Mapping):
        values = in_order(joint_positions, names, "position")
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
        kind: what the values are, "position" or "velocity".

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
    """Reject a joint of less than one turn of range that is half a turn beyond its limits: its unit is not radians."""
    lower, upper = tree.lower_limits, tree.upper_limits
    turning = {joint.name for joint in tree.urdf.joints if joint.kind == "revolute"}
    far = (positions < lower - np.pi) | (positions > upper + np.pi)
    for index in np.flatnonzero(far & (upper - lower < 2.0 * np.pi)).tolist():
        name, value = tree.joint_names[index], positions[index]
        if name in turning:
            raise JointPositionError(
                f"joint {name} is at {value:g} rad, half a turn or more beyond its limits {lower[index]:g} ... "
                f"{upper[index]:g}; positions are in radians ({value:g} degrees are {np.radians(value):.4f} rad)"
            )


def beyond_limits(tree: KinematicTree, positions: Float) -> dict[str, float]:
    """Joints beyond their limits and by how much [rad]; one `JointLimitWarning` lists them.

    They are accepted: encoders have offsets, and the limits in a URDF are nominal.
    """
    beyond: dict[str, float] = {}
    complaints = []
    lower, upper = tree.lower_limits, tree.upper_limits
    for index in np.flatnonzero((positions < lower - LIMIT_TOLERANCE) | (positions > upper + LIMIT_TOLERANCE)):
        name, value = tree.joint_names[index], positions[index]
        beyond[name] = float(max(lower[index] - value, value - upper[index]))
        complaints.append(
            f"joint {name} is at {value:.4f} rad, {beyond[name]:.4f} rad beyond its limits "
            f"{lower[index]:g} ... {upper[index]:g}"
        )
    if complaints:
        more = f"; and {len(complaints) - NAMED} more joints" if len(complaints) > NAMED else ""
        warnings.warn(
            "; ".join(complaints[:NAMED]) + more,
            JointLimitWarning,
            stacklevel=4,  # the caller of RobotModel.state
        )
    return beyond
