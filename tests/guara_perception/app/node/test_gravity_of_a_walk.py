"""Gravity carried by leg odometry to the next scan of a walk without an IMU."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.app.node.walk_map import WalkMap
from kinematics import LegOdometry, RobotModel
from testbed.analytic_walk import Ground, LevelGround, scan, walk

pytestmark = pytest.mark.slow


def test_scans_are_level_by_the_gravity_of_their_walk(robot: RobotModel, calibration: gp.Calibration) -> None:
    """Gravity of leg odometry at the pause, before and after the map has it; none for another walk or with an IMU."""
    random = Ground.random(0)
    ground = LevelGround(random.boxes[:0], random.dark[:0], random.phases)
    walk_map, odometry = WalkMap(robot, calibration), LegOdometry(robot)
    for pause in walk(robot, ground, 1, 0, has_gravity=False):
        carried = walk_map.gravity(pause.step, pause.stance, epoch="a")
        assert carried == odometry.carried_gravity(pause.stance)
        assert (carried is None) == (pause.step == 0)
        walk_map.update(pause.step, pause.stance, scan(robot, ground, pause, 0), epoch="a")
        pose = odometry.update(pause.stance).pose
        again = walk_map.gravity(pause.step, pause.stance, epoch="a")
        if carried is None:
            assert again is None
        else:
            assert again is not None and again.sigma == carried.sigma
            np.testing.assert_allclose(again.gravity_in_base, -pose.up_in_base, atol=1e-12)
    assert walk_map.gravity(pause.step + 1, pause.stance, epoch="b") is None
    assert walk_map.gravity(pause.step - 1, pause.stance, epoch="a") is None
    with_imu = dataclasses.replace(pause.stance, gravity_in_base=(0.0, 0.0, -1.0))
    assert walk_map.gravity(pause.step + 1, with_imu, epoch="a") is None
