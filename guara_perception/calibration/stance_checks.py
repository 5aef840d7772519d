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
    """The angle between two mounts: one from the soles as the joint angles put them, one from the measured gravity.

    The pictures give the camera's pose over the floor; the stance gives that of `base_link` over the floor, by the
    soles and by gravity, and on a level floor both agree. The angle between the two floor normals is the angle between
    the two mounts, whatever the camera saw.

    Args:
        robot: the model.
        stance: the stance in which the session's pictures were taken.

    Returns:
        One check; none without gravity or with fewer than three feet.
    """
    if stance.gravity_in_base is None or len(stance.support_feet) < LEAST_FEET:
        return []
    from_gravity, from_joints = (
        np.asarray(robot.stance_pose(stance, attitude=source).transform_base_to_footprint)[:3, :3]
        for source in ("imu", "support_plane")
    )
    # The floor's normal in base_link by each. The arc cosine alone would lose small angles to rounding.
    normal, other = from_gravity[2], from_joints[2]
    angle = float(np.arctan2(np.linalg.norm(np.cross(normal, other)), normal @ other))
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
