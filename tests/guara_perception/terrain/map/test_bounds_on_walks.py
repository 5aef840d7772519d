"""On walks that drift, the true ground is below the bounds of unknown ground."""

from __future__ import annotations

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.terrain.layers.layers import CEILING_SIGMA_M
from guara_perception.terrain.layers.record import ScanRecord
from kinematics import LegOdometry, PoseInOdom, RobotModel
from testbed.analytic_walk import CAMERA_IN_BASE, Ground, scan, seen_height, walk


@pytest.mark.heavy
@pytest.mark.parametrize("seed", [1, 2])
def test_on_a_walk_that_drifts_the_truth_is_below_the_bounds(robot: RobotModel, seed: int) -> None:
    """Boxes, dark and hidden ground: no bound is exceeded by over 5 mm at five points of each unknown cell."""
    ground, bounded = Ground.random(seed), 0
    terrain_map, odometry = gp.TerrainMap(robot), LegOdometry(robot)
    camera = np.eye(4)
    camera[:3, 3] = CAMERA_IN_BASE
    for pause in walk(robot, ground, 2, seed):
        plain = scan(robot, ground, pause, seed)
        terrain = gp.TerrainGrid(
            layers=dict(plain.layers),
            geometry=plain.geometry,
            stamp=plain.stamp,
            step=plain.step,
            record=ScanRecord.from_json({**plain.metadata, "transform_camera_to_base": camera.tolist()}),
        )
        pose = odometry.update(pause.stance)
        fused = terrain_map.update(
            terrain,
            PoseInOdom(pose.transform_footprint_to_odom, pose.covariance, pose.covariance_since_last),
        )
        iy, ix = np.nonzero(np.isfinite(fused.ceiling))
        x, y = fused.geometry.centres()
        to_footprint = np.array(terrain.metadata["transform_base_to_footprint"])
        to_world = pause.transform_base_to_world @ np.linalg.inv(to_footprint)
        for dx, dy in ((0, 0), (-0.002, -0.002), (-0.002, 0.002), (0.002, -0.002), (0.002, 0.002)):
            true, _ = seen_height(ground, to_world, x[ix] + dx, y[iy] + dy)
            assert (true <= fused.ceiling[iy, ix] + 0.005 + 4 * CEILING_SIGMA_M).all()
        bounded += iy.size
    assert bounded > 2000
