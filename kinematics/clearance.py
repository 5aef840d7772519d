"""Clearance of the sole and leg above the ground for a leg that stands on a foothold."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import numpy as np
import numpy.typing as npt

from kinematics.arrays import Float, read_only
from kinematics.exceptions import ArgumentError, StanceError
from kinematics.reach import reach_from_pose
from kinematics.stance_pose import StancePose
from kinematics.transforms import transform_points
from kinematics.tree import RobotState
from kinematics.urdf import Shape

# Heights (n,) [m] of the ground in `base_footprint` for x (n,) and y (n,) [m]; NaN where unknown.
HeightFunction = Callable[[Float, Float], npt.ArrayLike]

# Largest distance between neighbouring samples on sole and leg [m]: the default size of a grid cell.
SPACING = 0.005


@dataclass(frozen=True, slots=True, eq=False)
class FootholdClearance:
    """Clearances of leg and sole at one foothold [m]; each is NaN if any ground below that part is unknown.

    Attributes:
        leg: smallest height above the ground of all points of the leg that are farther from the sole's centre than the
            longer side of the sole; negative if the leg would penetrate the ground, inf if there are no such points.
        sole: smallest height of the sole above the ground; negative if a bump would press into the sole.
        sole_gap: largest height of the sole above the ground.
        joint_positions: (n,) positions of the leg's joints that place the sole on the foothold [rad].
    """

    leg: float
    sole: float
    sole_gap: float
    joint_positions: Float


def foothold_clearance(
    pose: StancePose, leg: str, sole_in_footprint: npt.ArrayLike, height_at: HeightFunction
) -> FootholdClearance:
    """Compute the clearances of a leg that stands on a foothold with a level sole, for a stance pose of the body.

    Args:
        pose: pose of the body and of all joints; the joints of `leg` are replaced.
        leg: name of the leg.
        sole_in_footprint: (3,) sole centre [m].
        height_at: function that returns the heights of the ground at given points.

    Raises:
        UnknownName: the robot has no such leg.
        ArgumentError: `sole_in_footprint` is not three finite numbers, or `height_at` does not return one height per
            point.
        StanceError: the foothold is out of the leg's reach.
    """
    sole = np.asarray(sole_in_footprint, dtype=np.float64)
    if sole.shape != (3,) or not np.all(np.isfinite(sole)):
        raise ArgumentError(f"sole_in_footprint is {sole.tolist()}; allowed: 3 finite numbers")
    reach = reach_from_pose(pose, leg, sole)
    if not reach.is_reachable:
        raise StanceError(f"leg {leg!r} does not reach the foothold ({sole[0]:.3f}, {sole[1]:.3f}, {sole[2]:.3f})")
    tree = pose.state.tree
    config = tree.leg(leg)
    positions = dict(pose.state.joint_positions)
    positions.update(zip(config.joints, reach.joint_positions.tolist(), strict=True))
    state = RobotState(tree, positions)
    length, width = tree.config.sole
    patch = _box_points(np.array([length, width, 0.0]) / 2.0)
    # A leg of fewer than four joints cannot level its sole. Its foot is assumed to be round, with a level contact
    # patch.
    round_foot = len(config.joints) < 4
    on_sole = _above_ground(sole + patch if round_foot else _in_footprint(pose, state, config.sole, patch), height_at)
    over_leg = _above_ground(_leg_points(pose, state, leg), height_at)
    # min and max propagate NaN, so one sample over unknown ground makes the clearance unknown.
    return FootholdClearance(
        float(np.min(over_leg, initial=np.inf)),
        float(np.min(on_sole)),
        float(np.max(on_sole)),
        read_only(reach.joint_positions),
    )


def _leg_points(pose: StancePose, state: RobotState, leg: str) -> Float:
    """Points (n, 3) in base_footprint on the leg's shapes, farther from the sole's centre than its longer side."""
    config = state.tree.leg(leg)
    above = {joint.child: joint for joint in state.tree.urdf.joints}
    centre = _in_footprint(pose, state, config.sole, np.zeros((1, 3)))
    points, link = [np.zeros((0, 3))], config.sole
    while True:
        points += [_in_footprint(pose, state, link, shape_points(shape)) for shape in state.tree.links[link].shapes]
        if above[link].name == config.joints[0]:
            break
        link = above[link].parent
    everywhere = np.concatenate(points)
    return everywhere[np.linalg.norm(everywhere - centre, axis=1) > max(state.tree.config.sole)]


def _in_footprint(pose: StancePose, state: RobotState, frame: str, points: Float) -> Float:
    return transform_points(pose.transform_base_to_footprint @ state.transform_to_base(frame), points)


def _above_ground(points: Float, height_at: HeightFunction) -> Float:
    heights = np.asarray(height_at(points[:, 0], points[:, 1]), dtype=np.float64)
    if heights.shape != (len(points),):
        raise ArgumentError(f"height_at returned shape {heights.shape}; allowed: ({len(points)},)")
    return np.asarray(points[:, 2] - heights)


def shape_points(shape: Shape) -> Float:
    """Points (n, 3) on the surface of a shape, in the frame of its link; end faces of cylinders only at their rims."""
    if shape.kind == "box":
        points = _box_points(np.asarray(shape.size) / 2.0)
    elif shape.kind == "cylinder":
        radius, length = shape.size
        points = np.concatenate([_circle(radius, height) for height in _spaced(length / 2.0)])
    else:
        (radius,) = shape.size
        latitudes = _spaced(np.pi / 2.0, SPACING / radius)
        points = np.concatenate([_circle(radius * np.cos(a), radius * np.sin(a)) for a in latitudes])
    return transform_points(shape.transform_shape_to_link, points)


def _spaced(half: float, spacing: float = SPACING) -> Float:
    """Evenly spaced numbers from -half to half, both included, at most `spacing` apart."""
    return np.linspace(-half, half, max(2, int(np.ceil(2.0 * half / spacing)) + 1))


def _circle(radius: float, height: float) -> Float:
    angles = _spaced(np.pi, SPACING / max(radius, SPACING))
    return np.column_stack([radius * np.cos(angles), radius * np.sin(angles), np.full(len(angles), height)])


def _box_points(half: Float) -> Float:
    """Points (n, 3) on the whole surface of a box with half extents (3,), including its corners."""
    axes = [_spaced(h) if h > 0.0 else np.zeros(1) for h in half]
    points = np.array(list(product(*axes)))
    on_surface = np.any(np.abs(points) >= half - 1e-12, axis=1)
    return points[on_surface]
