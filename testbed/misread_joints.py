"""Walks of Guará and of stock robots over level ground, joints that read wrong in them, and what is told of these."""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Sequence
from pathlib import Path

from guara_perception.app.robot_folder.new_robot import new_robot
from guara_perception.simulation.walk import WalkNoise, WalkPause, simulate_walk
from guara_perception.simulation.world import World
from kinematics import JointCheck, JointFault, RobotModel, Stance, load_robot
from testbed.stock_robots import stock_urdf

GROUND = World(x=(-2.0, 40.0), y=(-0.8, 0.8), features=())
ERROR = 0.1
# 4 % of the way of a foot that stands while the body advances by a cycle of 140 mm in four pauses.
CREEP = 0.0014
IMU_SIGMA = 0.00175


def load(name: str) -> RobotModel:
    """Guará, or a stock robot by name."""
    if name == "guara":
        return load_robot(name)
    with tempfile.TemporaryDirectory() as folder:
        new_robot(stock_urdf(name), Path(folder) / name)
        return load_robot(Path(folder) / name)


def walk(
    robot: RobotModel, pauses: int, seed: int, *, has_imu: bool, creep: float = CREEP, is_declared: bool = True
) -> list[WalkPause]:
    """A walk over level ground, which the gait declares at the first pause, or not."""
    noise = WalkNoise(imu=IMU_SIGMA if has_imu else None, creep=creep)
    found = list(simulate_walk(GROUND, robot, cycles=(pauses - 1) / len(robot.legs), seed=seed, noise=noise))
    return found if is_declared else [dataclasses.replace(pause, known_ground=()) for pause in found]


def misread(stance: Stance, joint: str, error: float) -> Stance:
    """The stance with an error of one joint."""
    joints = {**stance.joint_positions, joint: stance.joint_positions[joint] + error}
    return Stance(joints, stance.support_feet, stance.gravity_in_base)


def ground_of(pause: WalkPause) -> dict[str, tuple[float, float]]:
    """What the gait declares of the ground below each sole, at the first pause."""
    return {leg: (each.height, each.sigma) for each in pause.known_ground for leg in pause.stance.support_feet}


def alarms(robot: RobotModel, pauses: Sequence[WalkPause]) -> int:
    """Pauses of a clean walk at which something is told."""
    check = JointCheck(robot)
    return sum(bool(check.update(pause.stance, ground_of(pause)).faults) for pause in pauses)


def is_named(faults: Sequence[JointFault], joint: str, kind: str) -> bool:
    """Whether a fault of this kind names the joint."""
    return any(fault.kind == kind and joint in fault.joints for fault in faults)
