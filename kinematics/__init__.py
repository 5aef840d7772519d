"""Kinematics of walking robots: poses of body, legs and camera from joint positions.

`load_robot` loads and checks a robot folder. The resulting `RobotModel` computes a `RobotState` from joint positions
and a `StancePose` from a `Stance`. Pinocchio is imported when the first robot is loaded, not with this package.
"""

from __future__ import annotations

from kinematics.body_track import BodyPlace as BodyPlace
from kinematics.body_track import BodyTrack as BodyTrack
from kinematics.clearance import FootholdClearance as FootholdClearance
from kinematics.clearance import foothold_clearance as foothold_clearance
from kinematics.exceptions import ArgumentError as ArgumentError
from kinematics.exceptions import CameraMoved as CameraMoved
from kinematics.exceptions import JointLimitWarning as JointLimitWarning
from kinematics.exceptions import JointPositionError as JointPositionError
from kinematics.exceptions import KinematicsError as KinematicsError
from kinematics.exceptions import LibraryMissing as LibraryMissing
from kinematics.exceptions import OdometryLost as OdometryLost
from kinematics.exceptions import RobotFileError as RobotFileError
from kinematics.exceptions import RobotFileWarning as RobotFileWarning
from kinematics.exceptions import RobotNotFound as RobotNotFound
from kinematics.exceptions import StanceError as StanceError
from kinematics.exceptions import UnknownName as UnknownName
from kinematics.footprint import BASE_FOOTPRINT as BASE_FOOTPRINT
from kinematics.footprint import ODOM as ODOM
from kinematics.joint_check import JointCheck as JointCheck
from kinematics.joint_check import JointFault as JointFault
from kinematics.joint_check import JointReport as JointReport
from kinematics.load import describe_robot as describe_robot
from kinematics.load import load_robot as load_robot
from kinematics.load import robot_from_description as robot_from_description
from kinematics.model import RobotModel as RobotModel
from kinematics.odometry import LegOdometry as LegOdometry
from kinematics.odometry import OdometryPose as OdometryPose
from kinematics.odometry import PoseInOdom as PoseInOdom
from kinematics.pause import PauseDetector as PauseDetector
from kinematics.pause import PauseReport as PauseReport
from kinematics.reach import Reach as Reach
from kinematics.reach import reach_from_pose as reach_from_pose
from kinematics.reach import reach_in_base as reach_in_base
from kinematics.self_filter import SelfFilter as SelfFilter
from kinematics.stability import polygon_margin as polygon_margin
from kinematics.stability import stability_margin as stability_margin
from kinematics.stance import Stance as Stance
from kinematics.stance_pose import ATTITUDE_SOURCES as ATTITUDE_SOURCES
from kinematics.stance_pose import GravityEstimate as GravityEstimate
from kinematics.stance_pose import StanceNoise as StanceNoise
from kinematics.stance_pose import StancePose as StancePose
from kinematics.stance_pose import stance_pose as stance_pose
from kinematics.stillness import CameraMotion as CameraMotion
from kinematics.stillness import Stillness as Stillness
from kinematics.stillness import camera_motion as camera_motion
from kinematics.stillness import check_camera_still as check_camera_still
from kinematics.tree import RobotState as RobotState
