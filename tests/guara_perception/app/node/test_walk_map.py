"""Map of a walk as kept by the node: images correct it, and measure the slip of standing feet."""

from __future__ import annotations

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.app.node.walk_map import WalkMap
from guara_perception.simulation import SimulatedRangefinder, World, specimen
from guara_perception.simulation.walk import WalkNoise, simulate_walk
from kinematics import RobotModel


@pytest.mark.slow
def test_feet_that_all_slide_alike_are_seen(robot: RobotModel) -> None:
    """Their distances stay the same, so joints cannot show it; images do, and the map stays aligned with the ground."""
    world, calibration = World(seed=1), specimen(robot, (640, 512), 1)
    rangefinder, walk_map = SimulatedRangefinder(world, calibration, robot, 1), WalkMap(robot, calibration)
    exact = WalkNoise(joint=0.0, contact=0.0, slip=0.0, imu=0.0, slide=0.08)
    begun = None
    for pause in simulate_walk(world, robot, cycles=0.75, seed=1, noise=exact):
        rangefinder.set_pose(pause.transform_base_to_world, pause.joint_positions)
        processor = gp.ScanProcessor(calibration, robot, pause.stance, "coarse", step=pause.step)
        for index, on, off in rangefinder.frames(range(0, 70, 2)):
            processor.add(index, on, off)
        picture = processor.ground_picture
        fused = walk_map.update(pause.step, pause.stance, processor.finish("wide"), picture=picture)
        begun = pause.transform_footprint_to_world if begun is None else begun
        truth = np.linalg.inv(begun) @ pause.transform_footprint_to_world
        found = np.array(fused.metadata["transform_footprint_to_odom"])
        np.testing.assert_allclose(found[:2, 3], truth[:2, 3], atol=3e-4)
        if pause.step == 0:
            assert "foot_slips" not in fused.metadata
            continue
        pose = walk_map.pose
        assert pose is not None and pose.foot_slips == fused.metadata["foot_slips"]
        # The cycle is 140 mm, in four swings.
        slips = fused.metadata["foot_slips"]
        assert len(slips) == 3
        np.testing.assert_allclose(list(slips.values()), 0.08 * 0.035, atol=4e-4)
