"""Stairs: treads and edges of rendered flights compared with their world; None for other ground."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pypcd4 import PointCloud

import guara_perception as gp
from guara_perception.settings import Settings
from guara_perception.simulation import SimulatedRangefinder, specimen
from guara_perception.simulation.features import Box, Ramp, Step
from guara_perception.simulation.features import Stairs as Flight
from guara_perception.simulation.world import World
from kinematics import RobotModel, Stance

# Half of the widest gap between the stripes of a standard scan, plus one cell.
EDGE_M = 0.010
STAIRCASE = Path(__file__).parents[3] / "data" / "plane_seg" / "anymal_staircase_06.pcd"


def rendered(robot: RobotModel, *features: Flight | Step | Box | Ramp, mode: str = "standard") -> gp.TerrainGrid:
    """Scan of a world by the simulated rangefinder, frame by frame."""
    calibration = specimen(robot, (320, 256), 0)
    stance = Stance(robot.posture("scan"), robot.legs, (0, 0, -1))
    view = SimulatedRangefinder(World(features=features), calibration, robot, 0)
    view.set_pose(robot.stance_pose(stance).transform_base_to_footprint, stance.joint_positions)
    processor = gp.ScanProcessor(calibration, robot, stance, mode)
    for index, on, off in view.frames(Settings.of(robot).pattern(mode)):
        processor.add(index, on, off)
    return processor.finish()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("x", "height", "count", "run", "direction"),
    [
        (0.60, 0.03, 3, 0.11, "up"),
        pytest.param(0.58, 0.02, 4, 0.09, "up", marks=pytest.mark.heavy),
        pytest.param(0.62, 0.03, 2, 0.12, "down", marks=pytest.mark.heavy),
    ],
)
def test_rendered_flights_are_found(
    robot: RobotModel, x: float, height: float, count: int, run: float, direction: str
) -> None:
    """Every tread has its height, and every edge its position, to the spacing of stripes."""
    terrain = rendered(robot, Flight(x=x, height=height, count=count, run=run, direction=direction))
    found = terrain.stairs()
    assert found is not None and len(found.risers) == count and len(found.treads) == count + 1
    up = np.array([1.0, 0.0]) if direction == "up" else np.array([-1.0, 0.0])
    np.testing.assert_allclose(found.direction, up, atol=0.05)
    assert abs(found.rise - height) < 0.001 and abs(found.run - run) < EDGE_M
    edges = x + run * np.arange(count)
    for riser, edge in zip(found.risers, edges if direction == "up" else edges[::-1], strict=True):
        for end in (riser.start, riser.end):
            assert abs(end[0] - edge) < EDGE_M
        # The left end for a climbing robot comes first; the edge is as wide as the area.
        across = riser.start - riser.end
        assert up[0] * across[1] - up[1] * across[0] > 0.45
        assert abs(riser.height - height) < 0.0015
    tread_heights = [tread.centre[2] for tread in found.treads]
    assert np.diff(tread_heights) == pytest.approx(np.full(count, height), abs=0.0015)
    for tread in found.treads:
        assert np.hypot(*tread.plane[:2]) < 0.02 and tread.sigma < 0.001 and tread.area > 0.01


@pytest.mark.parametrize("yaw", [0.0, 0.4, -0.9, 2.5])
def test_flights_across_the_grid(yaw: float) -> None:
    """Rotated by any angle, with unknown holes; the direction is that of the climb."""
    y, x = (np.mgrid[:140, :140] + 0.5) * 0.005 - 0.35
    along = np.cos(yaw) * x + np.sin(yaw) * y
    heights = 0.025 * np.clip(np.floor((along + 0.15) / 0.1 + 1), 0, 3)
    rng = np.random.default_rng(3)
    heights += rng.normal(0, 2e-4, heights.shape)
    heights[rng.random(heights.shape) < 0.0005] = np.nan
    found = gp.assess_terrain(heights, 0.005, origin=(-0.35, -0.35)).stairs()
    assert found is not None and len(found.risers) == 3
    np.testing.assert_allclose(found.direction, [np.cos(yaw), np.sin(yaw)], atol=0.03)
    assert found.rise == pytest.approx(0.025, abs=5e-4) and found.run == pytest.approx(0.1, abs=0.004)
    for riser, edge in zip(found.risers, (-0.15, -0.05, 0.05), strict=True):
        for end in (riser.start, riser.end):
            assert end[:2] @ [np.cos(yaw), np.sin(yaw)] == pytest.approx(edge, abs=0.006)


@pytest.mark.parametrize("cell", [0.02, 0.025, 0.03])
def test_a_real_staircase_is_found(cell: float) -> None:
    """Elevation map of four real steps of about 165 mm by another robot, smeared beside the steps."""
    cloud = PointCloud.from_path(STAIRCASE).numpy(("x", "y", "z"))
    # Its points have their own grid, whose lines are not borders of cells.
    corner = cloud[:, :2].min(axis=0) - 0.007
    at = ((cloud[:, :2] - corner) / cell).astype(int)
    heights = np.full(at.max(axis=0)[::-1] + 1, -np.inf)
    np.maximum.at(heights, (at[:, 1], at[:, 0]), cloud[:, 2])
    heights[np.isinf(heights)] = np.nan
    found = gp.assess_terrain(heights, cell, origin=corner).stairs()
    assert found is not None and len(found.risers) == 4
    assert [riser.height for riser in found.risers] == pytest.approx([0.165] * 4, abs=0.015)
    np.testing.assert_allclose(found.direction, [1.0, 0.0], atol=0.06)
    assert found.run == pytest.approx(0.30, abs=0.015) and min(tread.area for tread in found.treads) > 0.1


@pytest.mark.slow
def test_what_is_no_flight_is_none(robot: RobotModel, paper_terrain: gp.TerrainGrid) -> None:
    """One step, a box, a ramp, level ground, the recorded scans; a flight with unequal rises."""
    assert paper_terrain.stairs() is None
    assert rendered(robot, Step(x=0.7, height=0.03), mode="coarse").stairs() is None
    assert rendered(robot, Box(x=0.7, y=0.0, size=(0.1, 0.1), height=0.04), mode="coarse").stairs() is None
    assert rendered(robot, Ramp(x=0.7, y=0.0, size=(0.3, 0.4), height=0.04), mode="coarse").stairs() is None
    assert gp.assess_terrain(np.zeros((90, 90)), 0.005).stairs() is None
    assert gp.assess_terrain(np.full((90, 90), np.nan), 0.005).stairs() is None
    x = np.arange(140) * 0.005
    odd = np.select([x < 0.2, x < 0.35, x < 0.5], [0.0, 0.02, 0.12], 0.14)
    assert gp.assess_terrain(np.tile(odd, (90, 1)), 0.005).stairs() is None


@pytest.mark.parametrize("sigma", [0.0, 0.005, 0.008])
def test_what_is_level_follows_from_the_sigma_of_the_grid(sigma: float) -> None:
    """Heights with the noise of a LIDAR, in cells of 20 mm: the flight is found if the grid states the noise."""
    y, x = (np.mgrid[:70, :100] + 0.5) * 0.02
    heights = 0.165 * np.clip(np.floor((x - 0.4) / 0.3 + 1), 0, 4)
    noisy = heights + np.random.default_rng(5).normal(0, sigma, heights.shape)
    found = gp.assess_terrain(noisy, 0.02, variance=np.full(heights.shape, sigma**2)).stairs()
    assert found is not None
    assert [riser.height for riser in found.risers] == pytest.approx([0.165] * 4, abs=0.015)
    assert found.run == pytest.approx(0.3, abs=0.02)
