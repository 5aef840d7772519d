"""The planner of strides crosses stepping stones by the map alone, with default settings."""

from __future__ import annotations

import importlib
from types import ModuleType

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.simulation import SimulatedRangefinder, World, specimen
from guara_perception.simulation.walk import Landing, WalkPause, simulate_walk
from kinematics import LegOdometry, RobotModel
from testbed.stones import END_M, stepping_stones
from tests.examples.test_examples import EXAMPLES

pytestmark = pytest.mark.heavy

# More relief under a sole than this is a misstep.
LARGEST_RELIEF_M = 0.010


@pytest.fixture
def planner_module(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(EXAMPLES))
    return importlib.import_module("stride_planner")


@pytest.mark.parametrize("seed", range(4))
def test_stepping_stones_are_crossed(seed: int, planner_module: ModuleType, robot: RobotModel) -> None:
    """Every foot ends up behind the stones, and none ever stands in a gap or on a rim."""
    world, calibration = stepping_stones(seed), specimen(robot, (640, 512), seed)
    rangefinder = SimulatedRangefinder(world, calibration, robot, seed)
    planner, terrain_map, odometry = planner_module.StridePlanner(robot), gp.TerrainMap(robot), LegOdometry(robot)
    maps: list[gp.TerrainGrid] = []

    def choose(pause: WalkPause) -> Landing | None:
        stride = planner.next_stride(maps[-1])
        if stride is None:
            return None
        return Landing(*stride.swing.points[-1][:2], stride.leg, stride.body[:2, 3])

    for pause in simulate_walk(world, robot, choose, cycles=15, seed=seed):
        if pause.last_footstep is not None:
            assert relief(world, robot, *pause.last_footstep.sole_in_world[:2]) <= LARGEST_RELIEF_M, pause.step
        if min(sole[0] for sole in pause.soles_in_world.values()) > END_M:
            return
        rangefinder.set_pose(pause.transform_base_to_world, pause.joint_positions)
        processor = gp.ScanProcessor(calibration, robot, pause.stance, step=pause.step)
        processor.add_all([gp.FramePair(*frames) for frames in rangefinder.frames(range(70))])
        picture = processor.ground_picture
        pose = odometry.update(pause.stance)
        scan = processor.finish("wide")
        maps.append(terrain_map.update(scan, pose, known_ground=pause.known_ground, picture=picture))
    pytest.fail(f"not across after {pause.step} swings")


def relief(world: World, robot: RobotModel, x: float, y: float) -> float:
    """Relief of the ground under a sole [m]."""
    along, across = (np.linspace(-size / 2, size / 2, 33) for size in robot.sole)
    heights = world.height(*(each.ravel() for each in np.meshgrid(x + along, y + across)))
    return float(np.ptp(heights))
