"""Where every part of a walking robot is, from its joint positions.

`load_robot` loads and checks a robot folder; a `RobotModel` gives a `RobotState` for joint positions and a
`StancePose` for a `Stance`. Pinocchio is imported when the first robot is loaded, not with this package.
"""

from kinematics.exceptions import (
    ArgumentError,
    CameraMoved,
    JointLimitWarning,
    JointPositionError,
    KinematicsError,
    RobotFileError,
    RobotNotFound,
    StanceError,
    UnknownName,
)
from kinematics.frames import BASE_FOOTPRINT, ODOM
from kinematics.model import RobotModel, load_robot
from kinematics.stance import Stance
from kinematics.stance_pose import ATTITUDE_SOURCES, GravityEstimate, StanceNoise, StancePose, stance_pose
from kinematics.state import RobotState

__all__ = [
    "ATTITUDE_SOURCES",
    "BASE_FOOTPRINT",
    "ODOM",
    "ArgumentError",
    "CameraMoved",
    "GravityEstimate",
    "JointLimitWarning",
    "JointPositionError",
    "KinematicsError",
    "RobotFileError",
    "RobotModel",
    "RobotNotFound",
    "RobotState",
    "Stance",
    "StanceError",
    "StanceNoise",
    "StancePose",
    "UnknownName",
    "load_robot",
    "stance_pose",
]
