"""Checks joint positions that come from outside and puts them into the robot's order."""

from __future__ import annotations

import warnings
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from kinematics.arrays import Float
from kinematics.exceptions import JointLimitWarning, JointPositionError, unknown_name
from kinematics.tree import KinematicTree

# Radians: a posture or a solution that stands exactly on a limit is not beyond it.
LIMIT_TOLERANCE = 1e-9

# Joints named in one warning; the others are counted.
NAMED = 3


def checked_positions(tree: KinematicTree, joint_positions: Mapping[str, float] | npt.ArrayLike) -> Float:
    """Joint positions (n,) [rad] in the order of `tree.joint_names`.

    Args:
        tree: the kinematic tree that names the joints.
        joint_positions: joint name -> position, every joint once; or an array in the order of `tree.joint_names`.

    Raises:
        UnknownName: a joint that the robot does not have.
        JointPositionError: a joint is missing, a value is not a finite number or plainly not in radians, or an array
            has the wrong length.
    """
    names = tree.joint_names
    if isinstance(joint_positions, Mapping):
        for name in joint_positions:
            if name not in names:
                raise unknown_name("joint", name, names)
        missing = [name for name in names if name not in joint_positions]
        if missing:
            raise JointPositionError(f"no position for {', '.join(missing)}; all {len(names)} joints are needed")
        values: npt.ArrayLike = [joint_positions[name] for name in names]
    else:
        values = joint_positions
    try:
        positions = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise JointPositionError(f"joint positions are not numbers: {values!r}") from None
    if positions.shape != (len(names),):
        raise JointPositionError(
            f"joint positions have shape {positions.shape}; ({len(names)},) is needed, in the order {', '.join(names)}"
        )
    for name, value in zip(names, positions, strict=True):
        if not np.isfinite(value):
            raise JointPositionError(f"joint {name}: position {value} is not finite")
    _refuse_other_units(tree, positions)
    return positions


def _refuse_other_units(tree: KinematicTree, positions: Float) -> None:
    """Refuse a joint with less than a turn of range that is half a turn beyond its limits: not given in radians."""
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

    A joint beyond its limit is a measurement, not a reason to stop: encoders are offset, limits in the URDF
    are nominal.
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
