"""A robot as the public functions take it: its model, or the name or folder by which it is loaded."""

from __future__ import annotations

from pathlib import Path
from typing import TypeAlias

from kinematics import RobotModel, load_robot

RobotLike: TypeAlias = RobotModel | str | Path


def robot_model(robot: RobotLike) -> RobotModel:
    """The model itself.

    Raises:
        kinematics.KinematicsError: there is no such robot, or its folder is not sound.
    """
    return load_robot(robot) if isinstance(robot, str | Path) else robot
