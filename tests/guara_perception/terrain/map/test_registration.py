"""Scan-to-map registration corrects a known shift if the ground shows it; otherwise odometry decides."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import guara_perception as gp
from kinematics import LegOdometry, PoseInOdom, RobotModel
from testbed.analytic_walk import LevelGround, scan, walk

MakeScan = Callable[..., gp.TerrainGrid]
SINCE_LAST = np.diag([0.002**2, 0.002**2, 0.001**2, 1e-8, 1e-8, 0.002**2])


def bumps(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Smooth ground that determines the position in x and y."""
    return np.asarray(0.012 * np.sin(40 * x) * np.cos(35 * y) + 0.008 * np.sin(23 * x + 31 * y))


def seen_from(
    make_scan: MakeScan, shift: tuple[float, float], step: int, *, flat: bool = False, stripes: bool = False
) -> gp.TerrainGrid:
    """Scan of the bumps by a robot that is displaced by `shift` from its odometry pose."""
    metadata = {"stripes_planned": 70} if stripes else {}
    grid = make_scan(0.0).geometry
    x, y = np.meshgrid(*grid.centres())
    heights = np.zeros(x.shape) if flat else bumps(x + shift[0], y + shift[1])
    return make_scan(heights + np.random.default_rng(step).normal(0, 2e-4, x.shape), step=step, metadata=metadata)


def correction(terrain: gp.TerrainGrid) -> np.ndarray:
    return np.array(terrain.metadata["sideways_correction"])


@pytest.mark.parametrize("shift", [(0.003, 0.0), (0.0, -0.003), (-0.002, 0.002)])
def test_a_shift_that_the_ground_shows_is_taken_off(
    robot: RobotModel, make_scan: MakeScan, shift: tuple[float, float]
) -> None:
    """Odometry reports no motion, but the robot moved: most of it is corrected, limited by the prior."""
    terrain_map = gp.TerrainMap(robot)
    terrain_map.update(
        seen_from(make_scan, (0, 0), 0), PoseInOdom(np.eye(4), np.zeros((6, 6)), covariance_since_last=SINCE_LAST)
    )
    fused = terrain_map.update(
        seen_from(make_scan, shift, 1), PoseInOdom(np.eye(4), SINCE_LAST, covariance_since_last=SINCE_LAST)
    )
    assert fused.metadata["registration_refused"] is None
    np.testing.assert_allclose(correction(fused)[:2], shift, atol=1e-3)
    assert max(fused.metadata["sideways_correction_sigma"][:2]) < 0.0015


def test_on_level_ground_odometry_decides(robot: RobotModel, make_scan: MakeScan) -> None:
    """Ground that does not determine the position gives no correction, and the sigma grows with the motion."""
    terrain_map = gp.TerrainMap(robot)
    for step in range(3):
        fused = terrain_map.update(
            seen_from(make_scan, (0.003, 0), step, flat=True),
            PoseInOdom(np.eye(4), step * SINCE_LAST, covariance_since_last=SINCE_LAST),
        )
    assert np.abs(correction(fused)[:2]).max() < 2e-4
    assert fused.metadata["sideways_correction_sigma"][0] > 0.002


@pytest.mark.slow
def test_seams_of_the_map_are_no_ground(robot: RobotModel) -> None:
    """Scans with small height errors leave seams at their ends, which must not move level ground.

    A walk with noise in joints, contacts and gravity, in which such seams once moved the map by centimetres.
    """
    ground = LevelGround(np.empty((0, 5)), np.empty((0, 3)), np.zeros((3, 2)))
    terrain_map, odometry = gp.TerrainMap(robot), LegOdometry(robot)
    for pause in walk(robot, ground, 3, 20):
        pose = odometry.update(pause.stance)
        fused = terrain_map.update(
            scan(robot, ground, pause, 20),
            PoseInOdom(
                pose.transform_footprint_to_odom, pose.covariance, covariance_since_last=pose.covariance_since_last
            ),
        )
        assert fused.metadata["registration_refused"] is None or pause.step < 2
    assert np.abs(correction(fused)[:2]).max() < 5e-4


def test_across_the_stripes_of_a_scan_odometry_decides(robot: RobotModel, make_scan: MakeScan) -> None:
    """Stripes determine the position along them only: across, edges err by up to their spacing, alike in each scan."""
    terrain_map = gp.TerrainMap(robot)
    for step, shift in enumerate(((0.0, 0.0), (0.003, 0.003))):
        fused = terrain_map.update(
            seen_from(make_scan, shift, step, stripes=True),
            PoseInOdom(np.eye(4), step * SINCE_LAST, covariance_since_last=SINCE_LAST),
        )
    x, y, _ = correction(fused)
    assert abs(x) < 5e-4
    assert y == pytest.approx(0.003, abs=1.2e-3)
    sigma_x, sigma_y, _ = fused.metadata["sideways_correction_sigma"]
    assert sigma_y < 0.0015 < 0.0018 < sigma_x


def test_a_turn_is_taken_off_too(robot: RobotModel, make_scan: MakeScan) -> None:
    """The robot has rotated by 5 mrad more than odometry reports."""
    grid = make_scan(0.0).geometry
    x, y = np.meshgrid(*grid.centres())
    turn = 0.005
    turned = bumps(np.cos(turn) * x - np.sin(turn) * y, np.sin(turn) * x + np.cos(turn) * y)
    unsure = np.diag([0.002**2, 0.002**2, 0.001**2, 1e-8, 1e-8, 0.01**2])
    terrain_map = gp.TerrainMap(robot)
    terrain_map.update(make_scan(bumps(x, y)), PoseInOdom(np.eye(4), np.zeros((6, 6)), covariance_since_last=unsure))
    fused = terrain_map.update(make_scan(turned, step=1), PoseInOdom(np.eye(4), unsure, covariance_since_last=unsure))
    assert correction(fused)[2] == pytest.approx(turn, abs=1e-3)


def test_an_overlap_that_contradicts_is_refused(robot: RobotModel, make_scan: MakeScan) -> None:
    """Other ground, or a motion far beyond odometry's error, moves nothing and is reported."""
    sure = SINCE_LAST / 100
    for other in (seen_from(make_scan, (0.3, 0.2), 1), seen_from(make_scan, (0.006, 0.0), 1)):
        terrain_map = gp.TerrainMap(robot)
        terrain_map.update(
            seen_from(make_scan, (0, 0), 0), PoseInOdom(np.eye(4), np.zeros((6, 6)), covariance_since_last=sure)
        )
        fused = terrain_map.update(other, PoseInOdom(np.eye(4), sure, covariance_since_last=sure))
        assert fused.metadata["registration_refused"]
        np.testing.assert_array_equal(correction(fused), 0.0)


@pytest.mark.slow
def part_moved(
    robot: RobotModel, make_scan: MakeScan, shares: tuple[float, ...], moved_by: tuple[float, ...]
) -> tuple[gp.TerrainGrid, np.ndarray]:
    """The robot is 3 mm beside its odometry pose; strips of the ground moved along y since the last scan."""
    terrain_map = gp.TerrainMap(robot)
    still = PoseInOdom(np.eye(4), np.zeros((6, 6)), covariance_since_last=SINCE_LAST)
    terrain_map.update(seen_from(make_scan, (0, 0), 0), still)
    x, y = np.meshgrid(*make_scan(0.0).geometry.centres())
    strip = np.searchsorted(np.quantile(y, np.cumsum(shares)), y)
    heights = bumps(x, y - 0.003 + np.array([0.0, *moved_by])[strip])
    seen = make_scan(heights + np.random.default_rng(3).normal(0, 2e-4, x.shape), step=1)
    fused = terrain_map.update(seen, PoseInOdom(np.eye(4), SINCE_LAST, covariance_since_last=SINCE_LAST))
    flags = np.asarray(fused.hazard_at(x, y)) & np.uint16(gp.Hazard.CONFLICT)
    return fused, np.array([np.mean(flags[strip == k] != 0) for k in range(1 + len(moved_by))])


def test_the_majority_of_the_ground_holds_the_map_and_the_rest_is_a_conflict(
    robot: RobotModel, make_scan: MakeScan
) -> None:
    """A third of the view moved by 15 mm: the rest determines the correction, and the third is CONFLICT."""
    whole, of_none = part_moved(robot, make_scan, (0.7,), (0.0,))
    fused, of_strips = part_moved(robot, make_scan, (0.7,), (0.015,))
    assert fused.metadata["registration_refused"] is None
    np.testing.assert_allclose(correction(fused)[:2], correction(whole)[:2], atol=5e-4)
    assert of_none.max() == 0
    assert of_strips[0] < 0.1 < 0.9 < of_strips[1]


def test_without_a_majority_nothing_is_corrected(robot: RobotModel, make_scan: MakeScan) -> None:
    """Each third of the view moved in another way."""
    fused, of_strips = part_moved(robot, make_scan, (0.34, 0.33), (0.015, -0.015))
    assert re.search("parts of the ground moved, and only .* % of the evidence", fused.metadata["registration_refused"])
    assert np.all(correction(fused) == 0)
    assert fused.metadata["sideways_correction_sigma"][1] >= 0.002
    assert np.median(of_strips) > 0.8


def test_a_saved_map_goes_on_with_its_correction(robot: RobotModel, make_scan: MakeScan, tmp_path: Path) -> None:
    """The file contains the state of the filter."""
    terrain_map = gp.TerrainMap(robot)
    for step, shift in enumerate(((0.0, 0.0), (0.003, 0.0))):
        terrain_map.update(
            seen_from(make_scan, shift, step),
            PoseInOdom(np.eye(4), step * SINCE_LAST, covariance_since_last=SINCE_LAST),
        )
    terrain_map.save(tmp_path / "map.npz")
    again = gp.TerrainMap.load(tmp_path / "map.npz", robot)
    scan = seen_from(make_scan, (0.003, 0.001), 2)
    one, two = (
        each.update(scan, PoseInOdom(np.eye(4), 2 * SINCE_LAST, covariance_since_last=SINCE_LAST))
        for each in (terrain_map, again)
    )
    np.testing.assert_array_equal(one.elevation, two.elevation)
    assert one.metadata["sideways_correction"] == two.metadata["sideways_correction"]
