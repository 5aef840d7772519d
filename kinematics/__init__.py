"""Where every part of a walking robot is, from its joint positions.

`load_robot` loads and checks a robot folder; a `RobotModel` gives a `RobotState` for joint positions and a
`StancePose` for a `Stance`. Pinocchio is imported when the first robot is loaded, not with this package.
"""

from __future__ import annotations

from kinematics.clearance import FootholdClearance, foothold_clearance
from kinematics.exceptions import (
    ArgumentError,
    CameraMoved,
    JointLimitWarning,
    JointPositionError,
    KinematicsError,
    OdometryLost,
    RobotFileError,
    RobotFileWarning,
    RobotNotFound,
    StanceError,
    UnknownName,
)
from kinematics.footprint import BASE_FOOTPRINT, ODOM
from kinematics.load import describe_robot, load_robot, robot_from_description
from kinematics.model import RobotModel
from kinematics.odometry import LegOdometry, OdometryPose, PoseInOdom
from kinematics.pause import PauseDetector, PauseReport
from kinematics.reach import Reach, reach_from_pose, reach_in_base
from kinematics.self_filter import SelfFilter
from kinematics.stability import polygon_margin, stability_margin
from kinematics.stance import Stance
from kinematics.stance_pose import ATTITUDE_SOURCES, GravityEstimate, StanceNoise, StancePose, stance_pose
from kinematics.state import RobotState
from kinematics.stillness import CameraMotion, Stillness, camera_motion, check_camera_still

__all__ = [
    "ATTITUDE_SOURCES",
    "BASE_FOOTPRINT",
    "ODOM",
    "ArgumentError",
    "CameraMotion",
    "CameraMoved",
    "FootholdClearance",
    "GravityEstimate",
    "JointLimitWarning",
    "JointPositionError",
    "KinematicsError",
    "LegOdometry",
    "OdometryLost",
    "OdometryPose",
    "PauseDetector",
    "PauseReport",
    "PoseInOdom",
    "Reach",
    "RobotFileError",
    "RobotFileWarning",
    "RobotModel",
    "RobotNotFound",
    "RobotState",
    "SelfFilter",
    "Stance",
    "StanceError",
    "StanceNoise",
    "StancePose",
    "Stillness",
    "UnknownName",
    "camera_motion",
    "describe_robot",
    "check_camera_still",
    "foothold_clearance",
    "load_robot",
    "polygon_margin",
    "reach_from_pose",
    "reach_in_base",
    "robot_from_description",
    "stability_margin",
    "stance_pose",
]
