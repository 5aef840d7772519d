"""Old heights at the near edge of a scan: forgotten if light returned nothing, kept if no light reached them."""

from __future__ import annotations

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.simulation import SimulatedRangefinder, World, specimen
from guara_perception.simulation.features import Patch, Pit, Step
from kinematics import LegOdometry, RobotModel
from kinematics.stance import Stance


def scanned(robot: RobotModel, world: World, step: int) -> tuple[gp.TerrainGrid, Stance]:
    """Coarse scan of a world from the start of the walk, and the stance."""
    stance = Stance(robot.posture(robot.config.scan_posture), robot.legs, (0.0, 0.0, -1.0))
    calibration = specimen(robot)
    rangefinder = SimulatedRangefinder(world, calibration, robot, seed=step)
    rangefinder.set_pose(robot.stance_pose(stance).transform_base_to_footprint, stance.joint_positions)
    processor = gp.ScanProcessor(calibration, robot, stance, "coarse", step=step)
    for index, on, off in rangefinder.frames(range(0, 70, 2)):
        processor.add(index, on, off)
    return processor.finish(), stance


def after(robot: RobotModel, world: World) -> tuple[gp.TerrainGrid, gp.TerrainGrid]:
    """Scan of a world, and its map after an earlier scan of an empty floor."""
    odometry, terrain_map = LegOdometry(robot), gp.TerrainMap(robot)
    for step, each in enumerate((World(), world)):
        scan, stance = scanned(robot, each, step)
        fused = terrain_map.update(scan, odometry.update(stance))
    return scan, fused


@pytest.mark.slow
@pytest.mark.parametrize(
    "feature",
    [
        Patch(x=0.53, y=0.0, size=(0.10, 0.16), material="dark"),
        Pit(x=0.53, y=0.0, size=(0.10, 0.16), depth=0.06),
        Pit(x=0.53, y=0.0, size=(0.10, 0.16), depth=0.30),
    ],
    ids=["dark mat", "pit", "hole"],
)
def test_what_appears_at_the_near_edge_erases_the_floor(robot: RobotModel, feature: Patch | Pit) -> None:
    """An absorbing mat, a pit and a hole: none of their cells keeps the height of the floor undisputed."""
    scan, fused = after(robot, World(features=(feature,)))
    x, y = np.meshgrid(np.arange(0.5025, 0.57, 0.005), np.arange(-0.0675, 0.07, 0.005))
    is_disputed = (np.asarray(fused.hazard_at(x, y)) & np.uint16(gp.Hazard.CONFLICT)) != 0
    assert not ((np.abs(fused.height_at(x, y)) < 0.01) & ~is_disputed).any()
    assert not np.asarray(fused.is_traversable(x, y)).any()
    assert not (scan.hazard_at(x, y) == gp.Hazard.UNSCANNED).any()


@pytest.mark.slow
def test_ground_that_no_stripe_could_meet_keeps_its_height(robot: RobotModel) -> None:
    """On a step of 80 mm, all stripes miss the near edge, so the map keeps its heights there."""
    scan, fused = after(robot, World(features=(Step(x=0.45, height=0.08),)))
    before = np.cumsum(np.isfinite(scan.elevation), axis=1) == 0
    inner = before & (np.abs(scan.geometry.centres()[1]) < 0.2)[:, None]
    assert inner.sum() >= 2 * 80
    assert (scan.hazard[inner] == gp.Hazard.UNSCANNED).mean() > 0.95
    iy, ix = np.nonzero(inner & (np.arange(scan.shape[1]) < 2))
    x, y = scan.geometry.centres()
    np.testing.assert_allclose(fused.height_at(x[ix], y[iy]), 0.0, atol=0.005)
