"""Checks of the input of the map at a pause: the grid of a scan, and the pose of the robot."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from guara_perception.arrays import Float
from guara_perception.exceptions import InvalidInput, refuse_stale
from guara_perception.terrain.grid import TerrainGrid
from kinematics import ArgumentError, KinematicsError, OdometryPose, PoseInOdom, RobotModel
from kinematics.transforms import checked_covariance, checked_transform, inverse

# Largest tilt of a footprint [rad]. Without gravity, a scan is levelled by its support plane. This plane tilts by
# 0.11 rad if two feet stand on a box of 40 mm.
LARGEST_TILT = 0.2
# Frame of the grids of scans.
FRAME = "base_footprint"
# Elements of a rotation smaller than this are set to zero, which moves the ground by nanometres at most.
LEAST_TURN = 1e-9


def check_scan(terrain: TerrainGrid, robot: str, resolution: float, last_step: int | None) -> None:
    """Reject a grid that cannot be fused.

    Args:
        terrain: grid of the scan.
        robot: name of the map's robot.
        resolution: resolution of the map [m].
        last_step: step of the last fused scan, None before the first.

    Raises:
        InvalidInput: the grid is not a single scan, is of another robot, frame or cell size, or is in the compact
            encoding; or its rounding cannot be read, or its step is not greater than `last_step`.
        transport.StaleTerrain: the grid is stale; in a map it would count as newly seen.
    """
    refuse_stale(terrain.stale_because, allow_stale=False)
    if terrain.extent != "footprint":
        raise InvalidInput(f"a grid of extent {terrain.extent!r} cannot be fused; allowed: 'footprint' (a scan)")
    if terrain.record.robot not in (None, robot) or terrain.frame != FRAME:
        raise InvalidInput(
            f"a scan of robot {terrain.record.robot!r} in frame {terrain.frame!r} cannot be fused; allowed: {robot!r}, "
            f"{FRAME!r}"
        )
    terrain.record.check("rounding")
    if terrain.record.rounding is not None:
        raise InvalidInput(
            "a grid in the compact encoding cannot be fused, because the map does not record how heights were rounded. "
            "Request the lossless grid, or the node's map (extent 'map')"
        )
    if abs(terrain.resolution - resolution) > 1e-9:
        raise InvalidInput(f"the scan has cells of {terrain.resolution} m; allowed: {resolution} m, as in the map")
    if last_step is not None and terrain.step <= last_step:
        raise InvalidInput(
            f"step {terrain.step} is not greater than {last_step}, the step of the last scan; add scans in the order "
            "of their pauses, and begin a new map for another walk"
        )


@dataclass(frozen=True, slots=True)
class CheckedPose:
    """Checked copies of the arrays of a `PoseInOdom`; `transform` is the pose of the scan's own footprint in odom."""

    transform: Float
    covariance: Float
    since_last: Float | None
    noise: Float


def checked_pose(terrain: TerrainGrid, pose: PoseInOdom) -> CheckedPose:
    """Check a pose; a pose of leg odometry is transformed to the footprint in which the scan was processed.

    Without gravity, the scan's footprint is parallel to the support plane, but the footprint of leg odometry is
    horizontal, according to gravity at earlier pauses.

    Raises:
        InvalidInput: a transform is unreadable, is not rigid or tilts by more than 0.2 rad, or a covariance is invalid.
    """
    given, own = pose.transform_footprint_to_odom, pose.own_covariance
    since_last = pose.covariance_since_last
    terrain.record.check("transform_base_to_footprint")
    to_footprint = terrain.record.transform_base_to_footprint
    try:
        if isinstance(pose, OdometryPose) and to_footprint is not None:
            levelled = checked_transform(to_footprint, "transform_base_to_footprint")
            given = pose.transform_base_to_odom @ inverse(levelled)
        matrix = checked_transform(given, "transform_footprint_to_odom")
        checked = CheckedPose(
            matrix,
            checked_covariance(pose.covariance, "covariance"),
            None if since_last is None else checked_covariance(since_last, "covariance_since_last"),
            checked_covariance(np.zeros((6, 6)) if own is None else own, "own_covariance"),
        )
    except ArgumentError as error:
        raise InvalidInput(str(error)) from None
    rotation = matrix[:3, :3]
    if rotation[2, 2] < np.cos(LARGEST_TILT):
        raise InvalidInput(
            f"transform_footprint_to_odom tilts by more than {LARGEST_TILT} rad: both frames must be level"
        )
    rotation[np.abs(rotation) < LEAST_TURN] = 0.0
    return checked


def tilt_between_looks(robot: RobotModel, terrain: TerrainGrid) -> Float:
    """Covariance (2, 2) of the tilt of a scan relative to the scans of other pauses [rad^2]; 0 if unknown.

    If odometry gives the vertical, its error is the same at all pauses of a walk, and scans differ by the noise of the
    feet. Otherwise, the result is the covariance of the scan's pose; with an IMU, it is that of the measured gravity.
    """
    record = terrain.record
    record.check("pose_covariance", "attitude_source", "stance")
    if record.attitude_source == "odometry" and record.stance is not None:
        try:
            return robot.stance_pose(record.stance, attitude="support_plane").covariance[3:5, 3:5]
        except KinematicsError:
            # Fewer than three feet.
            pass
    return np.zeros((2, 2)) if record.pose_covariance is None else record.pose_covariance[3:5, 3:5]


def tilt_since(terrain: TerrainGrid, between_looks: Float, pauses: int) -> Float:
    """Covariance (2, 2) of the tilt of soles relative to ground seen some pauses earlier [rad^2].

    Args:
        terrain: scan of the pause of the soles.
        between_looks: result of `tilt_between_looks`.
        pauses: number of pauses since the ground was seen.
    """
    if terrain.record.attitude_source == "odometry":
        # Odometry carries the vertical from each pause to the next by two readings of the feet.
        return 2.0 * pauses * between_looks
    return np.diag(np.full(2, terrain.record.attitude_sigma or 0.0) ** 2)
