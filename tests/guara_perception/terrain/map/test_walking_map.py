"""Map of a walk: fixed cells in odom, conservative snapshots, growing variance, bounded memory."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import guara_perception as gp
from guara_perception.terrain.layers.hazard import Hazard
from kinematics import PoseInOdom, RobotModel
from tests.guara_perception.terrain.map.poses import AROUND, POINT, ZERO, MakeScan, at, drift, only
from tests.thorough import examples


@pytest.mark.slow
@settings(max_examples=examples(12), deadline=None, derandomize=True)
@given(yaw=st.floats(-np.pi, np.pi), x=st.floats(-3, 3), y=st.floats(-3, 3), z=st.floats(-0.2, 0.2))
def test_a_look_from_anywhere_comes_back_at_its_position(
    robot: RobotModel, make_scan: MakeScan, scan_grid: Any, yaw: float, x: float, y: float, z: float
) -> None:
    """For any pose, a map of one scan has each height within 1.5 cells of its place."""
    gx, gy = np.meshgrid(*scan_grid.centres())
    fused = gp.TerrainMap(robot).update(make_scan(0.1 * gx - 0.2 * gy), PoseInOdom(at(x, y, yaw, z), ZERO))
    inner = fused.elevation[30:110, 235:295].astype(np.float64)
    fx, fy = np.meshgrid(*fused.geometry.centres())
    expected = (0.1 * fx - 0.2 * fy)[30:110, 235:295]
    assert np.isfinite(inner).all()
    assert np.abs(inner - expected).max() < 0.3 * 1.5 * 0.005


def test_a_scan_from_a_tilted_footprint_is_turned_upright(
    robot: RobotModel, make_scan: MakeScan, scan_grid: Any
) -> None:
    """Ground seen from a footprint tilted by 5 degrees is level in odom, and tilted again in the snapshot."""
    gx, gy = np.meshgrid(*scan_grid.centres())
    tilt = np.radians(5)
    tilted = np.eye(4)
    tilted[:3, :3] = [[np.cos(tilt), 0, np.sin(tilt)], [0, 1, 0], [-np.sin(tilt), 0, np.cos(tilt)]]
    terrain_map = gp.TerrainMap(robot)
    fused = terrain_map.update(make_scan(np.tan(tilt) * gx), PoseInOdom(tilted, ZERO))
    fx, _ = np.meshgrid(*fused.geometry.centres())
    seen = np.isfinite(fused.elevation)
    assert seen.sum() > 9000
    np.testing.assert_allclose(fused.elevation[seen], np.tan(tilt) * fx[seen], atol=4e-4)
    nothing = np.full(scan_grid.shape, np.uint16(Hazard.UNSCANNED))
    upright = terrain_map.update(make_scan(0.0, flags=nothing, step=1), PoseInOdom(at(), ZERO))
    assert np.nanmax(np.abs(upright.elevation)) < 4e-4


@pytest.mark.slow
def test_cells_stand_still_in_odom(robot: RobotModel, make_scan: MakeScan, scan_grid: Any) -> None:
    """A height seen once keeps its exact value over a walk, because nothing is resampled."""
    rng = np.random.default_rng(3)
    heights = rng.normal(0, 0.003, (108, 90))
    terrain_map = gp.TerrainMap(robot)
    before = terrain_map.update(make_scan(heights), PoseInOdom(at(), ZERO))
    nothing = np.full(scan_grid.shape, np.uint16(Hazard.UNSCANNED))
    for step in range(1, 21):
        after = terrain_map.update(make_scan(0.0, flags=nothing, step=step), PoseInOdom(at(0.035 * step), ZERO))
    # 20 * 35 mm are 140 cells of 5 mm.
    np.testing.assert_array_equal(after.elevation[16:124, 80:170], before.elevation[16:124, 220:310])


@pytest.mark.slow
def test_what_lies_far_behind_is_forgotten_and_memory_does_not_grow(robot: RobotModel, make_scan: MakeScan) -> None:
    """After 5 m the first scan is forgotten, even if the robot returns; the arrays keep their size."""
    terrain_map = gp.TerrainMap(robot)
    terrain_map.update(make_scan(0.004), PoseInOdom(at(), ZERO))
    size = sum(array.nbytes for array in terrain_map._cells.memory.values())
    unscanned = np.full((108, 90), np.uint16(Hazard.UNSCANNED))
    for step in range(1, 21):
        terrain_map.update(make_scan(0.0, flags=unscanned, step=step), PoseInOdom(at(0.25 * step), ZERO))
    back = terrain_map.update(make_scan(0.0, flags=unscanned, step=21), PoseInOdom(at(), ZERO))
    assert np.isnan(back.elevation).all()
    assert sum(array.nbytes for array in terrain_map._cells.memory.values()) == size
    assert size < 40e6


def test_a_snapshot_joins_the_flags_of_cells_touched(robot: RobotModel, make_scan: MakeScan, scan_grid: Any) -> None:
    """Half a cell farther, a cell that touches one without a return is unknown: two columns instead of one."""
    hole = only(Hazard.DROPOUT, scan_grid, (0.70, 0.705, 0.0, 0.005))
    terrain_map = gp.TerrainMap(robot)
    whole = terrain_map.update(make_scan(0.0, flags=hole), PoseInOdom(at(), ZERO))
    nothing = np.full(scan_grid.shape, np.uint16(Hazard.UNSCANNED))
    shifted = terrain_map.update(make_scan(0.0, flags=nothing, step=1), PoseInOdom(at(0.0025, 0.0025), ZERO))
    inside = np.s_[40:100, 240:290]
    assert np.isnan(whole.elevation[inside]).sum() == 1
    assert np.isnan(shifted.elevation[inside]).sum() == 4


@pytest.mark.slow
@settings(max_examples=examples(8), deadline=None, derandomize=True)
@given(x=st.floats(0, 0.005), y=st.floats(0, 0.005), yaw=st.floats(-0.1, 0.1), turn=st.floats(-0.1, 0.1))
def test_no_point_without_return_is_known_later(
    robot: RobotModel, make_scan: MakeScan, scan_grid: Any, x: float, y: float, yaw: float, turn: float
) -> None:
    """For any alignment of scan, map and view, a point with a missing return is in an unknown cell."""
    gap = only(Hazard.DROPOUT, scan_grid, (0.70, 0.72, -0.30, 0.30)) | only(Hazard.DROPOUT, scan_grid, AROUND)
    terrain_map = gp.TerrainMap(robot)
    terrain_map.update(make_scan(0.0, flags=gap), PoseInOdom(at(x, y, yaw), ZERO))
    nothing = np.full(scan_grid.shape, np.uint16(Hazard.UNSCANNED))
    later = at(0.07, -y, turn)
    fused = terrain_map.update(make_scan(0.0, flags=nothing, step=1), PoseInOdom(later, ZERO))
    px, py = (a.ravel() for a in np.meshgrid(np.linspace(0.6801, 0.7199, 60), np.linspace(-0.1999, 0.1999, 600)))
    empty = gap[scan_grid.indices(px, py)] != 0
    points = np.stack((px, py, np.zeros(px.size), np.ones(px.size)))[:, empty]
    px, py, *_ = np.linalg.solve(later, at(x, y, yaw) @ points)
    assert np.isnan(fused.height_at(px, py)).all()


@pytest.mark.slow
def test_no_narrow_bump_slips_between_nearest_cells(robot: RobotModel, make_scan: MakeScan, scan_grid: Any) -> None:
    """A bump of one cell remains in elevation_max for any heading of the snapshot."""
    gx, gy = np.meshgrid(*scan_grid.centres())
    bump = np.where((np.abs(gx - 0.7025) < 1e-3) & (np.abs(gy - 0.0025) < 1e-3), 0.04, 0.0)
    nothing = np.full(scan_grid.shape, np.uint16(Hazard.UNSCANNED))
    for yaw in np.linspace(0.02, 0.5, 12):
        terrain_map = gp.TerrainMap(robot)
        terrain_map.update(make_scan(bump), PoseInOdom(at(), ZERO))
        turned = terrain_map.update(make_scan(0.0, flags=nothing, step=1), PoseInOdom(at(0.1, 0.0, yaw), ZERO))
        assert np.nanmax(turned.elevation_max) == np.float32(0.04)


def test_variance_grows_with_travel(robot: RobotModel, make_scan: MakeScan, scan_grid: Any) -> None:
    """Unobserved cells gain odometry's variance in z; on a slope also that of its horizontal drift."""
    gx, _ = np.meshgrid(*scan_grid.centres())
    nothing = np.full(scan_grid.shape, np.uint16(Hazard.UNSCANNED))
    grown = {}
    for name, heights in (("flat", 0.0), ("slope", 0.2 * gx)):
        terrain_map = gp.TerrainMap(robot)
        terrain_map.update(make_scan(heights), PoseInOdom(at(), ZERO))
        after = terrain_map.update(make_scan(0.0, flags=nothing, step=1), PoseInOdom(at(), drift(0.002, 0.004)))
        iy, ix = (int(i) for i in after.geometry.indices(*POINT))
        grown[name] = float(after.variance[iy, ix])
    assert grown["flat"] == pytest.approx(0.002**2 + 0.0002**2 + 0.0005**2, rel=0.01)
    assert grown["slope"] - grown["flat"] == pytest.approx((0.2 * 0.004) ** 2 + 0.2**2 * 0.005**2 / 12, rel=0.02)


def test_tilt_of_the_stance_makes_far_cells_less_sure(robot: RobotModel, make_scan: MakeScan) -> None:
    """A pitch known to 0.2 degrees moves a point at x vertically by x times that."""
    covariance = np.zeros((6, 6))
    covariance[4, 4] = np.radians(0.2) ** 2
    scan = make_scan(0.0, metadata={"pose_covariance": covariance.tolist()})
    fused = gp.TerrainMap(robot).update(scan, PoseInOdom(at(), ZERO))
    for x in (0.55, 0.90):
        iy, ix = (int(i) for i in fused.geometry.indices(x, 0.0))
        expected = (np.radians(0.2) * fused.geometry.centres()[0][ix]) ** 2 + 0.0002**2 + 0.0005**2
        assert fused.variance[iy, ix] == pytest.approx(expected, rel=0.01)
