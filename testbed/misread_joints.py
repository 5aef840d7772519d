"""Walks of the Guará and of stock robots over level ground, with errors of joint readings, for `JointCheck`."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from guara_perception.simulation.walk import WalkNoise, WalkPause, simulate_walk
from guara_perception.simulation.world import World
from kinematics import JointCheck, JointFault, RobotModel, Stance, load_robot
from testbed.stock_robots import stock_robot

GROUND = World(x=(-2.0, 40.0), y=(-0.8, 0.8), features=())
ERROR = 0.1
# Creep of a standing foot between two pauses [m]: 4 % of the advance of 35 mm, a quarter of a cycle of 140 mm.
CREEP = 0.0014
IMU_SIGMA = 0.00175


def load(name: str) -> RobotModel:
    """Load the Guará or a stock robot by name.

    Raises:
        StockRobotsMissing: the package of the stock robot is not installed.
    """
    return load_robot(name) if name == "guara" else stock_robot(name)


def walk(
    robot: RobotModel, pauses: int, seed: int, *, has_imu: bool, creep: float = CREEP, is_declared: bool = True
) -> list[WalkPause]:
    """Simulate a walk over level ground, which the gait declares at the first pause if `is_declared`."""
    noise = WalkNoise(imu=IMU_SIGMA if has_imu else None, creep=creep)
    found = list(simulate_walk(GROUND, robot, cycles=(pauses - 1) / len(robot.legs), seed=seed, noise=noise))
    return found if is_declared else [dataclasses.replace(pause, known_ground=()) for pause in found]


def misread(stance: Stance, joint: str, error: float) -> Stance:
    """Return a copy of a stance with an error of one joint [rad]."""
    joints = {**stance.joint_positions, joint: stance.joint_positions[joint] + error}
    return Stance(joints, stance.support_feet, stance.gravity_in_base)


def ground_of(pause: WalkPause) -> dict[str, tuple[float, float]]:
    """Height and sigma of the ground declared by the gait [m], by leg; empty after the first pause."""
    return {leg: (each.height, each.sigma) for each in pause.known_ground for leg in pause.stance.support_feet}


def alarms(robot: RobotModel, pauses: Sequence[WalkPause]) -> int:
    """Count the pauses of a walk at which `JointCheck` reports a fault."""
    check = JointCheck(robot)
    return sum(bool(check.update(pause.stance, ground_of(pause)).faults) for pause in pauses)


def is_named(faults: Sequence[JointFault], joint: str, kind: str) -> bool:
    """Test that one of the faults has this kind and names this joint."""
    return any(fault.kind == kind and joint in fault.joints for fault in faults)
