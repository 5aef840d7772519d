"""Reach of a leg on a grid, with the body at its pose when the grid was made."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from guara_perception.arrays import Float
from guara_perception.exceptions import InvalidInput
from guara_perception.settings import RobotLike, robot_model
from guara_perception.terrain.layers.layered_grid import LayeredGrid
from guara_perception.terrain.layers.record import GridRecord
from kinematics import RobotModel, RobotNotFound, StancePose, load_robot, robot_from_description
from kinematics.reach import leg_kinematics, reach_from_pose
from kinematics.stance_pose import support_soles
from kinematics.transforms import transform_points


@dataclass(frozen=True, slots=True, eq=False)
class StandingSole:
    """Sole that carried the body when the grid was made, in base_footprint.

    Attributes:
        centre: (3,) centre [m].
        covariance: (3, 3) covariance of the centre [m^2].
    """

    centre: Float
    covariance: Float


# Load a robot by name or folder; the four robots used last are cached.
_loaded = lru_cache(maxsize=4)(robot_model)
# Bound on the amount by which a joint position between two tested heights can exceed its values at both heights [rad].
BETWEEN_HEIGHTS = 1e-6


def beyond_reach_of_ground(
    terrain: LayeredGrid, leg: str, soles_in_footprint: Float, robot: RobotLike | None = None
) -> Float:
    """Worst case of `beyond_reach` over the rounding of heights, for positions whose z is from the grid."""
    off = terrain.record.checked_rounding.elevation
    if off == 0:
        return beyond_reach(terrain, leg, soles_in_footprint, robot)
    tried = [soles_in_footprint + (0.0, 0.0, z) for z in (-off, 0.0, off)]
    return np.max([beyond_reach(terrain, leg, soles, robot, margin=BETWEEN_HEIGHTS) for soles in tried], axis=0)


def beyond_reach(
    terrain: LayeredGrid,
    leg: str,
    soles_in_footprint: Float,
    robot: RobotLike | None = None,
    *,
    margin: float = 0.0,
) -> Float:
    """Excess of the leg's joints over their limits [rad]: 0 within reach, NaN if no joint positions reach.

    Args:
        terrain: grid with the stance in its record.
        leg: name of the leg.
        soles_in_footprint: (n, 3) centres of the level sole [m].
        robot: model, name or folder of the robot; None = the description in the grid or, without one, the name in it.
        margin: angle to keep from the limits [rad].

    Raises:
        InvalidInput: the grid's record lacks robot, stance or transform, one of them is unreadable, or `robot` is not
            the robot of the grid.
        kinematics.KinematicsError: no such leg, or the robot cannot be loaded or does not fit the stance.
    """
    pose = pose_of(terrain, robot)
    reach = reach_from_pose(pose, leg, soles_in_footprint)
    solver = leg_kinematics(pose.state.tree, leg)
    joints = np.asarray(reach.joint_positions)
    lower, upper = solver.lower + margin, solver.upper - margin
    excess = np.maximum(np.maximum(lower - joints, joints - upper), 0.0).max(axis=-1)
    within = reach.is_reachable if margin == 0 else reach.is_reachable & (excess == 0)
    return np.where(within, 0.0, np.where(excess > 0, excess, np.nan))


def standing_sole(terrain: LayeredGrid, leg: str, robot: RobotLike | None = None) -> Float:
    """Sole centre (3,) of a leg when the grid was made, in base_footprint of the grid [m].

    Raises:
        InvalidInput: the grid's record lacks robot, stance or transform, one of them is unreadable, or `robot` is not
            the robot of the grid.
        kinematics.KinematicsError: no such leg, or the robot cannot be loaded or does not fit the stance.
    """
    pose = pose_of(terrain, robot)
    return transform_points(pose.transform_base_to_footprint, pose.state.soles_in_base([leg]))[0]


def standing_soles(terrain: LayeredGrid) -> tuple[StandingSole, ...]:
    """Soles that carried the body when the grid was made.

    Raises:
        InvalidInput: the grid's record contains neither these soles nor robot, stance and transform.
        kinematics.KinematicsError: the robot cannot be loaded or does not fit the stance.
    """
    terrain.record.check("support_feet_used", "support_soles")
    soles = terrain.record.support_soles
    if soles is None:  # A grid of an earlier version.
        legs = terrain.record.support_feet_used or ()
        pose, noise = pose_of(terrain, None), _model_of(terrain, None).noise
        soles = {leg: sole for leg, sole in support_soles(pose, noise).items() if leg in legs}
    return tuple(StandingSole(sole[0], sole[1:]) for sole in soles.values())


def pose_of(terrain: LayeredGrid, robot: RobotLike | None) -> StancePose:
    """Pose of the body and joint positions when the grid was made.

    Raises:
        InvalidInput: the grid's record lacks robot, stance or transform, one of them is unreadable, or `robot` is not
            the robot of the grid.
        kinematics.KinematicsError: the robot cannot be loaded or does not fit the stance.
    """
    record, needed = terrain.record, ("robot", "stance", "transform_base_to_footprint")
    record.check(*needed)
    missing = [name for name in needed if getattr(record, name) is None]
    if missing:
        raise InvalidInput(
            f"the grid's metadata lacks {', '.join(missing)}, so only queries with leg=None are possible"
        )
    return _pose(_model_of(terrain, robot), record)


def _model_of(terrain: LayeredGrid, robot: RobotLike | None) -> RobotModel:
    record = terrain.record
    record.check("robot_description")
    if robot is None:
        return _robot(str(record.robot), record.robot_description)
    model = _loaded(robot)
    if model.name != record.robot:
        raise InvalidInput(f"the grid belongs to robot {record.robot!r}, but the given model is {model.name!r}")
    return model


@lru_cache(maxsize=4)
def _robot(name: str, description: str | None) -> RobotModel:
    """Robot from a description, or by name if there is no description; the four robots used last are cached."""
    if description is not None:
        return robot_from_description(description)
    try:
        return load_robot(name)
    except RobotNotFound as error:
        raise RobotNotFound(
            f"the grid contains no description of its robot {name!r}: give robot=load_robot(FOLDER). {error}"
        ) from None


@lru_cache(maxsize=4)
def _pose(robot: RobotModel, record: GridRecord) -> StancePose:
    assert record.stance is not None and record.transform_base_to_footprint is not None
    pose = robot.stance_pose(record.stance)
    return dataclasses.replace(pose, transform_base_to_footprint=record.transform_base_to_footprint)
