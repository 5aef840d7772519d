"""Compares the mount that follows from a session's joint angles with the one that follows from gravity."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from guara_perception.calibration.quality import Check

if TYPE_CHECKING:
    from kinematics import RobotModel, Stance

# Fewer soles make no plane.
LEAST_FEET = 3


def stance_checks(robot: RobotModel, stance: Stance) -> list[Check]:
    """How far two mounts differ: one from the soles as the joint angles put them, one from the measured gravity.

    The camera sees the floor alone. Base and floor are tied by the stance, in two ways that must agree on a level
    floor; their angle is the angle between the two mounts, whatever the camera saw.

    Args:
        robot: the model.
        stance: of the session.

    Returns:
        One figure, none without gravity or with fewer than three feet.
    """
    if stance.gravity_in_base is None or len(stance.support_feet) < LEAST_FEET:
        return []
    by_gravity, by_joints = (
        np.asarray(robot.stance_pose(stance, attitude=source).transform_base_to_footprint)[:3, :3]
        for source in ("imu", "support_plane")
    )
    # The up direction of each in base_link; the sine by the cross product is exact for small angles.
    up, other = by_gravity[2], by_joints[2]
    angle = float(np.arctan2(np.linalg.norm(np.cross(up, other)), up @ other))
    return [
        Check(
            "mount by joints and gravity",
            float(np.rad2deg(angle)),
            "degrees",
            0.5,
            2.0,
            "Angle between the mount that follows from the joint angles and the one that follows from gravity.",
            "level the floor; check that all soles lie flat on it, the zeros of the joints, and how the IMU is mounted",
        )
    ]
