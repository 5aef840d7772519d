"""A scan beside a foot of the robot: where a stripe ends at the foot, the foot is the cause."""

from __future__ import annotations

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.simulation import SimulatedRangefinder, World, specimen
from guara_perception.simulation.gait import WaveGait, stand_on
from kinematics import RobotModel, Stance


@pytest.mark.slow
def test_ground_at_the_toe_is_hidden_and_keeps_what_was_seen_before(robot: RobotModel) -> None:
    """The toe just reaches the scanned area: SELF there, so that a map keeps its ground; AMBIGUOUS erased a stone."""
    toe = 0.453, -0.18
    soles = {
        leg: np.array([*xy, 0.0])
        for leg, xy in {"lf": (0.25, 0.19), "rf": toe, "lh": (-0.15, 0.18), "rh": (-0.2, -0.18)}.items()
    }
    transform, joints = stand_on(robot, soles, (0.0, 0.0), WaveGait.of(robot).hip_height)
    calibration = specimen(robot, (640, 512), 1)
    rangefinder = SimulatedRangefinder(World(undulation=0.0), calibration, robot, 1)
    rangefinder.set_pose(transform, joints)
    processor = gp.ScanProcessor(calibration, robot, Stance(joints, tuple(robot.legs), (0.0, 0.0, -1.0)))
    processor.add_all([gp.FramePair(*frames) for frames in rangefinder.frames(range(14))])
    terrain = processor.finish("wide")
    x, y = np.meshgrid(*terrain.geometry.centres())
    near = (x < 0.56) & (np.abs(y - toe[1]) < 0.06)
    causes = terrain.hazard[near & np.isnan(terrain.elevation)]
    assert causes.size and (causes == gp.Hazard.SELF).all()
