"""Clearance of a leg over the ground, with its sole on a foothold."""

from __future__ import annotations

import numpy as np

from guara_perception.arrays import Array, Float
from guara_perception.settings import RobotLike
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK
from guara_perception.terrain.layers.layered_grid import LayeredGrid, asked
from guara_perception.terrain.questions.leg_reach import pose_of
from guara_perception.terrain.questions.path import UNRELIABLE, swing_ground
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

    The height of the ground is an upper bound: highest samples, or the ceiling of unknown ground, plus confidence.
    Parts of the leg that are closer to the sole's centre than the longer side of the sole are not tested. The result is
    negative if the leg would be in the ground. It is NaN if the ground at the position is unknown, if ground below the
    leg is unknown without a ceiling, STALE or off the grid, or if the leg cannot reach the position.

    Args:
        x, y: centre of the sole in base_footprint [m].
        leg, robot: as in `check_foothold`.

    Raises:
        InvalidInput: as in `check_foothold`.
        kinematics.KinematicsError: no such leg or robot.
    """
    terrain = asked(terrain, allow_stale)
    pose = pose_of(terrain, robot)
    # A height that was rounded counts with the least value that it may have had.
    sole = np.array([x, y, float(terrain.height_at(x, y)) - terrain.record.checked_rounding.elevation])
    ground = swing_ground(terrain, np.nan_to_num(sole))
    sigma = np.sqrt(ground.variance.astype(np.float64))
    bound = np.where((ground.hazard & (UNKNOWN_MASK | UNRELIABLE)) == 0, ground.top + ground.confidence * sigma, np.nan)

    def highest(at_x: Float, at_y: Float) -> Array:
        iy, ix = terrain.geometry.indices(at_x, at_y)
        inside = terrain.geometry.contains(iy, ix)
        return np.where(inside, bound[np.where(inside, iy, 0), np.where(inside, ix, 0)], np.nan)

    if not np.isfinite(sole).all():
        return np.nan
    try:
        return foothold_clearance(pose, leg, sole, highest).leg
    except StanceError:
        return np.nan
