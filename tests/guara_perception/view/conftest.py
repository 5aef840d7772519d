"""A robot and a grid, for tests of the page."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.simulation import World
from guara_perception.simulation.features import Box
from guara_perception.terrain.layers.geometry import GridGeometry
from guara_perception.terrain.layers.record import ScanRecord
from kinematics import RobotModel, Stance, load_robot


@pytest.fixture(scope="session")
def robot() -> RobotModel:
    return load_robot("guara")


@pytest.fixture(scope="session")
def grid(robot: RobotModel) -> gp.TerrainGrid:
    """Exact terrain with two boxes and an unknown patch, and the stance of the robot behind it."""
    world = World(
        features=(Box(x=0.7, y=0.1, size=(0.1, 0.1), height=0.06), Box(x=0.8, y=-0.1, size=(0.1, 0.1), height=0.02))
    )
    x, y = GridGeometry.over((0.0, 0.95), (-0.27, 0.27), 0.005).centres()
    elevation = world.height(*np.meshgrid(x, y))
    elevation[20:40, 60:80] = np.nan
    terrain = gp.assess_terrain(elevation, 0.005, origin=(0.0, -0.27))
    stance = Stance(robot.posture("scan"), robot.legs, (0, 0, -1))
    pose = robot.stance_pose(stance)
    metadata = {
        **terrain.metadata,
        "robot": "guara",
        "mode": "standard",
        "stance": stance.to_dict(),
        "attitude_source": "imu",
        "transform_base_to_footprint": pose.transform_base_to_footprint.tolist(),
        "health": {"level": "ok", "reasons": []},
    }
    return dataclasses.replace(terrain, record=ScanRecord.from_json(metadata), step=7)
