"""Inverse kinematics of a leg: joint positions for sole positions, and reachability of these positions."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from kinematics.arrays import Float, Mask, read_only
from kinematics.exceptions import ArgumentError
from kinematics.leg import LegGeometry, NumericLeg, find_leg_geometry
from kinematics.stance_pose import StancePose
from kinematics.transforms import checked_points
from kinematics.tree import LIMIT_TOLERANCE, KinematicTree


@dataclass(frozen=True, slots=True, eq=False)
class Reach:
    """Solution of the inverse kinematics of one leg for sole centres (..., 3); arrays are read-only.

    Attributes:
        joint_positions: (..., joints of the leg) [rad]; NaN where there is no solution.
        is_reachable: (...) bool, True if there is a solution within the joint limits.
    """

    joint_positions: Float
    is_reachable: Mask


@lru_cache(maxsize=64)
def leg_kinematics(tree: KinematicTree, leg: str) -> LegGeometry | NumericLeg:
    """Closed-form solver of a leg if its geometry allows it, else the numeric solver; cached.

    Raises:
        UnknownName: the robot has no such leg.
    """
    geometry = find_leg_geometry(tree, leg)
    if geometry is not None:
        return geometry
    columns = [tree.joint_index(joint) for joint in tree.leg(leg).joints]
    return NumericLeg(tree, leg, tree.nominal[columns])


def reach_in_base(
    tree: KinematicTree, leg: str, soles_in_base: npt.ArrayLike, sole_pitch: npt.ArrayLike = 0.0
) -> Reach:
    """Compute the joint positions of a leg that place its sole at given points of `base_link`.

    Args:
        tree: the robot's kinematic tree.
        leg: name of the leg.
        soles_in_base: (..., 3) sole centres in `base_link` [m]; a point with NaN has no solution.
        sole_pitch: pitch of the sole in the leg's plane [rad], one number or an array (...); legs of three joints or
            fewer ignore the pitch.

    Raises:
        UnknownName: the robot has no such leg.
        ArgumentError: an array has the wrong shape.
    """
    soles = checked_points(soles_in_base, "soles_in_base")
    try:
        pitch = np.broadcast_to(np.asarray(sole_pitch, dtype=np.float64), soles.shape[:-1])
    except ValueError:
        raise ArgumentError(
            f"sole_pitch has shape {np.shape(sole_pitch)}; one number or {soles.shape[:-1]} is needed"
        ) from None
    solver = leg_kinematics(tree, leg)
    positions = solver.solve(soles.reshape(-1, 3), pitch.reshape(-1))
    # Comparisons with NaN are false, so a sole without a solution is not reachable.
    within = np.all(
        (positions >= solver.lower - LIMIT_TOLERANCE) & (positions <= solver.upper + LIMIT_TOLERANCE), axis=1
    ).reshape(soles.shape[:-1])
    within.setflags(write=False)
    return Reach(read_only(positions.reshape(*soles.shape[:-1], positions.shape[1])), within)


def reach_from_pose(pose: StancePose, leg: str, soles_in_footprint: npt.ArrayLike) -> Reach:
    """Compute the joint positions of a leg that place its level sole on the ground, with the body at a stance pose.

    Args:
        pose: the stance pose.
        leg: name of the leg.
        soles_in_footprint: (..., 3) sole centres in `base_footprint` [m]: x, y and the height of the ground there.

    Raises:
        UnknownName: the robot has no such leg.
        ArgumentError: the array has the wrong shape.
    """
    soles = checked_points(soles_in_footprint, "soles_in_footprint")
    return reach_from_bodies(pose.state.tree, leg, soles, pose.transform_base_to_footprint)


def reach_from_bodies(
    tree: KinematicTree, leg: str, soles: npt.ArrayLike, transforms_base_to_ground: npt.ArrayLike
) -> Reach:
    """Compute the joint positions of a leg that place its level sole on the ground, for given poses of the body.

    Args:
        tree: the robot's kinematic tree.
        leg: name of the leg.
        soles: (..., 3) sole centres [m], in a frame whose z axis is vertical.
        transforms_base_to_ground: (..., 4, 4) poses of the body in that frame, broadcast against the soles.

    Raises:
        UnknownName: the robot has no such leg.
        ArgumentError: `soles` is not (..., 3), the poses are not (..., 4, 4), or the two cannot be broadcast.
    """
    points = checked_points(soles, "soles")
    bodies = np.asarray(transforms_base_to_ground, dtype=np.float64)
    if bodies.shape[-2:] != (4, 4):
        raise ArgumentError(f"transforms_base_to_ground has shape {bodies.shape}; (..., 4, 4) is needed")
    rotations = bodies[..., :3, :3]
    try:
        in_base = np.squeeze((points - bodies[..., :3, 3])[..., None, :] @ rotations, axis=-2)
    except ValueError:
        raise ArgumentError(
            f"soles and transforms_base_to_ground have shapes {points.shape} and {bodies.shape}; they must broadcast "
            "to (..., 3) and (..., 4, 4)"
        ) from None
    return reach_in_base(tree, leg, in_base, level_sole_pitch(tree, leg, in_base, rotations[..., 2, :]))


def level_sole_pitch(tree: KinematicTree, leg: str, soles_in_base: Float, up_in_base: Float) -> Float:
    """Pitch (...) [rad] in the leg's plane that makes the soles' x axis horizontal, for soles (..., 3) in `base_link`.

    At hip roll q and pitch p, the sole's x axis is (cos p, sin q sin p, -cos q sin p). It is horizontal if
    perpendicular to the vertical u (..., 3): tan p = u_x / (u_z cos q - u_y sin q).
    """
    reach, up = soles_in_base - leg_kinematics(tree, leg).hip, np.moveaxis(up_in_base, -1, 0)
    roll = np.arctan2(reach[..., 1], -reach[..., 2])
    return np.asarray(np.arctan2(up[0], up[2] * np.cos(roll) - up[1] * np.sin(roll)))
