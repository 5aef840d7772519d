"""Clearance of a leg over the ground, with its sole on a foothold."""

from __future__ import annotations

from functools import partial

import numpy as np

from guara_perception.exceptions import InvalidInput
from guara_perception.settings import RobotLike
from guara_perception.terrain.layers.layered_grid import LayeredGrid, asked
from guara_perception.terrain.questions.leg_reach import pose_of
from guara_perception.terrain.questions.path import highest_ground, swing_ground
from kinematics import StanceError, foothold_clearance


def leg_clearance(
    terrain: LayeredGrid,
    x: float,
    y: float,
    leg: str,
    robot: RobotLike | None = None,
    *,
    allow_stale: bool = False,
) -> float:
    """Least height of a leg above the ground [m], with its sole on a foothold and the body at its pose in the scan.

    The ground is at an upper bound of its height: the highest sample, or the ceiling of unknown ground, plus
    `confidence` standard deviations. Unknown cells under a sole that stands at the position are at the sole's height.
    Parts of the leg that are closer to the sole's centre than the longer side of the sole are not tested. The result is
    negative if the leg would be in the ground, and inf if no part of the leg is tested. It is NaN if the ground at the
    position is unknown, if other ground below the leg is unknown without a ceiling, STALE or off the grid, or if the
    leg cannot reach the position.

    Args:
        x, y: centre of the sole in base_footprint [m].
        leg, robot: as in `check_foothold`.

    Raises:
        InvalidInput: as in `check_foothold`, or x or y is an array.
        kinematics.KinematicsError: no such leg, or the robot cannot be loaded or does not fit the stance.
    """
    terrain = asked(terrain, allow_stale)
    if np.ndim(x) or np.ndim(y):
        raise InvalidInput(f"x and y have shapes {np.shape(x)} and {np.shape(y)}; two numbers are needed [m]")
    pose = pose_of(terrain, robot)
    # A rounded height is taken as the least value that it may have had before rounding.
    sole = np.array([x, y, float(terrain.height_at(x, y)) - terrain.record.checked_rounding.elevation])
    ground = swing_ground(terrain, np.nan_to_num(sole))
    if not np.isfinite(sole).all():
        return np.nan
    try:
        return foothold_clearance(pose, leg, sole, partial(highest_ground, ground)).leg
    except StanceError:
        return np.nan
