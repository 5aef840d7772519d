"""Poses of scans in odom, their covariance, and flags within a box."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from guara_perception.terrain.layers.hazard import Hazard
from kinematics import RobotModel

MakeScan = Any
ZERO = np.zeros((6, 6))
# Point in odom at the centre of a scan that is taken at the origin.
POINT = (0.7025, 0.0025)


def at(x: float = 0.0, y: float = 0.0, yaw: float = 0.0, z: float = 0.0) -> np.ndarray:
    """transform_footprint_to_odom."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s, 0, x], [s, c, 0, y], [0, 0, 1, z], [0, 0, 0, 1.0]])


def drift(rise: float = 0.0, shift: float = 0.0, turn: float = 0.0) -> np.ndarray:
    """Covariance of odometry from standard deviations."""
    return np.diag([shift**2, shift**2, rise**2, 0, 0, turn**2])


def only(flag: Hazard, scan_grid: Any, box: tuple[float, float, float, float]) -> np.ndarray:
    """Flags that are set within x0 ... x1, y0 ... y1."""
    x, y = scan_grid.centres()
    inside = (x >= box[0]) & (x < box[1]) & ((y >= box[2]) & (y < box[3]))[:, None]
    return np.where(inside, np.uint16(flag), 0).astype(np.uint16)


AROUND = (0.68, 0.72, -0.02, 0.02)


def stance_metadata(robot: RobotModel, joints: Mapping[str, float] | None = None) -> dict[str, Any]:
    """Metadata of a stance on level ground, by default in the scan posture."""
    from kinematics import Stance

    stance = Stance(robot.posture("scan") if joints is None else joints, robot.legs, (0, 0, -1))
    pose = robot.stance_pose(stance)
    return {
        "stance": stance.to_dict(),
        "transform_base_to_footprint": pose.transform_base_to_footprint.tolist(),
        "support_feet_used": list(robot.legs),
    }
