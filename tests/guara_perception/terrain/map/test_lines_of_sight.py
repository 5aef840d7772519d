"""Bounds of unknown ground: higher if less was observed, and removed by later observations."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.terrain.layers.hazard import Hazard
from guara_perception.terrain.map.lines_of_sight import NONE, _bounds
from kinematics import PoseInOdom, RobotModel, Stance
from testbed.analytic_walk import CAMERA_IN_BASE

MakeScan = Callable[..., gp.TerrainGrid]
NO_DRIFT = 1e-12 * np.eye(6)
# A hole of 40 x 30 mm in the observed ground, in cells of the scan.
HOLE = np.s_[50:56, 20:28]


@pytest.fixture
def where(robot: RobotModel) -> dict[str, object]:
    """Camera and body poses of a level stance, as in the metadata of a scan."""
    pose = robot.stance_pose(Stance(robot.posture("scan"), robot.legs, (0, 0, -1)))
    camera = np.eye(4)
    camera[:3, 3] = CAMERA_IN_BASE
    return {
        "transform_base_to_footprint": pose.transform_base_to_footprint.tolist(),
        "transform_camera_to_base": camera.tolist(),
        "validity_pauses": 40,
        "validity_seconds": 420.0,
    }


def flags_of(make_scan: MakeScan) -> np.ndarray:
    flags = np.zeros(make_scan(0.0).shape, np.uint16)
    flags[HOLE] = Hazard.DROPOUT
    return flags


def over_the_hole(make_scan: MakeScan, height: float) -> np.ndarray:
    """Path up, straight over the hole along y, and down."""
    x, y = make_scan(0.0).geometry.centres()
    at, first, last = x[24], y[40], y[66]
    return np.array([[at, first, 0.0], [at, first, height], [at, last, height], [at, last, 0.0]])


def test_a_swing_passes_over_a_hole_only_high_enough(
    robot: RobotModel, make_scan: MakeScan, where: dict[str, object]
) -> None:
    """Unknown ground counts as high as the light that passed over it; without such light it is rejected."""
    terrain = make_scan(0.0, flags=flags_of(make_scan), metadata=where)
    fused = gp.TerrainMap(robot).update(terrain, PoseInOdom(np.eye(4), NO_DRIFT))
    of_nowhere = {name: value for name, value in where.items() if name != "transform_camera_to_base"}
    unbounded = gp.TerrainMap(robot).update(
        make_scan(0.0, flags=flags_of(make_scan), metadata=of_nowhere), PoseInOdom(np.eye(4), NO_DRIFT)
    )
    assert np.isnan(unbounded.ceiling).all()
    hole = (fused.hazard & Hazard.DROPOUT) != 0
    assert hole.sum() == 48 and np.isfinite(fused.ceiling[hole]).all()
    # Not lower than the surrounding ground, and not higher than the camera rays over so small a hole plus margins.
    assert fused.ceiling[hole].min() > 0.0 and fused.ceiling[hole].max() < 0.12
    high, low = (over_the_hole(make_scan, z) for z in (fused.ceiling[hole].max() + 0.03, 0.02))
    for path in (high, low):
        assert unbounded.check_path(path, 0.015).reasons[0].test == "unknown"
    assert fused.check_path(high, 0.015).ok
    assert {reason.test for reason in fused.check_path(low, 0.015).reasons} == {"clearance"}
    # A track on the ground has no height: a bound never makes ground safe for a foot.
    assert not fused.check_path(low[:, :2], 0.015).ok
    start, end = high[0], high[-1]
    assert not unbounded.swing(start, end, 0.015).ok or len(unbounded.swing(start, end, 0.015).points) > 4
    found = fused.swing(start, end, 0.015)
    assert found.ok and fused.check_path(found.points, 0.015).ok
    assert not fused.check_foothold(*high[0, :2] + (0, 0.08)).ok


@pytest.mark.parametrize("behind", [0.0, 0.05, 0.3, 2.0])
def test_bounds_hold_wherever_the_laser_light_starts_to_widen(
    robot: RobotModel, make_scan: MakeScan, where: dict[str, object], behind: float
) -> None:
    """No bound from laser light is below the lowest light that truly passes over its cell.

    The light of a lens this far behind the mirror passes over a cell from another point of the ground than that of a
    lens on it; cells of which that point was not observed have no bound from laser light.
    """
    origin = np.array([0.6, 0.0, 0.47])
    aside = np.abs(make_scan(0.0).geometry.centres()[1])
    flags = np.where(aside < 0.15, Hazard.UNSCANNED, 0).astype(np.uint16)[:, None]
    terrain = make_scan(0.0, flags=flags, metadata={**where, "laser_origin": origin.tolist()})
    high = np.asarray(terrain.elevation_max, np.float64)
    x, y = (axis.ravel() for axis in np.meshgrid(*terrain.geometry.centres()))
    seen = np.isfinite(high.ravel())
    points = np.column_stack((x, y, np.zeros(x.size)))[seen]
    # Light from a point this far behind the axis, through the axis, to observed ground: where it is 20 to 140 mm high.
    to_axis = origin - points
    length = np.hypot(to_axis[:, 0], to_axis[:, 2])
    source = points + to_axis * (1 + behind / length)[:, None]
    source[:, 1] = origin[1]
    geometry = terrain.geometry.widened(20)
    passed = np.full(geometry.shape, np.inf)
    for rise in np.arange(0.0, 0.15, 0.001):
        at = points + (source - points) * (rise / source[:, 2])[:, None]
        iy, ix = geometry.indices(at[:, 0], at[:, 1])
        inside = geometry.contains(iy, ix)
        np.minimum.at(passed, (iy[inside], ix[inside]), rise)
    far_below = origin - (0.0, 0.0, 10.0)
    bounds = _bounds(terrain, geometry, [far_below, origin])
    bounded = bounds < NONE
    assert bounded.sum() > 1000
    assert (bounds[bounded] >= passed[bounded] - 0.001).all()


@pytest.mark.slow
def test_bounds_rise_with_drift_and_end_with_age(
    robot: RobotModel, make_scan: MakeScan, where: dict[str, object]
) -> None:
    """Bounds are dilated by the possible drift of the map, and expire at the age at which heights become STALE."""
    heights = []
    for sigma in (1e-6, 0.004, 0.012):
        terrain_map = gp.TerrainMap(robot)
        terrain = make_scan(0.0, flags=flags_of(make_scan), metadata=where)
        terrain_map.update(terrain, PoseInOdom(np.eye(4), NO_DRIFT))
        nothing_seen = make_scan(flags=int(Hazard.UNSCANNED), step=1, metadata=where)
        fused = terrain_map.update(nothing_seen, PoseInOdom(np.eye(4), np.diag([sigma**2] * 2 + [1e-12] * 4)))
        heights.append(np.where(np.isnan(h := fused.ceiling), np.inf, h))
    assert (heights[0] <= heights[1]).all() and (heights[1] <= heights[2]).all()
    assert (heights[0] < heights[1]).any() and (heights[1] < heights[2]).any()
    old = make_scan(flags=int(Hazard.UNSCANNED), step=41, stamp=41_000, metadata=where)
    assert np.isnan(terrain_map.update(old, PoseInOdom(np.eye(4), np.eye(6) * 1e-3)).ceiling).all()


def test_bounds_rise_with_the_height_that_the_walk_may_have_gained(
    robot: RobotModel, make_scan: MakeScan, where: dict[str, object]
) -> None:
    """Without soles to correct the height, 10 mm of drift in z raise every older bound by 2 sigma of it."""
    heights = []
    for sigma in (1e-6, 0.010):
        terrain_map = gp.TerrainMap(robot)
        terrain = make_scan(0.0, flags=flags_of(make_scan), metadata=where)
        terrain_map.update(terrain, PoseInOdom(np.eye(4), NO_DRIFT))
        nothing_seen = make_scan(flags=int(Hazard.UNSCANNED), step=1, metadata=where)
        fused = terrain_map.update(
            nothing_seen, PoseInOdom(np.eye(4), np.diag([1e-12, 1e-12, sigma**2, 1e-12, 1e-12, 1e-12]))
        )
        heights.append(fused.ceiling)
    bounded = np.isfinite(heights[0])
    assert bounded.sum() > 48 and (heights[1][bounded] >= heights[0][bounded] + 0.0199).all()


@pytest.mark.slow
def test_a_scan_that_is_taken_back_bounds_nothing(
    robot: RobotModel, make_scan: MakeScan, where: dict[str, object]
) -> None:
    """Neither at once, nor after the next pause, nor if its own pause is scanned again."""
    for step in (1, 2):
        terrain_map = gp.TerrainMap(robot)
        nothing_seen = make_scan(flags=int(Hazard.UNSCANNED), metadata=where)
        fused = terrain_map.update(nothing_seen, PoseInOdom(np.eye(4), NO_DRIFT))
        terrain_map.keep()
        wrong = make_scan(0.0, flags=flags_of(make_scan), step=1, metadata=where)
        contradicted = terrain_map.update(wrong, PoseInOdom(np.eye(4), NO_DRIFT))
        assert np.isfinite(contradicted.ceiling).any()
        terrain_map.take_back()
        again = make_scan(flags=int(Hazard.UNSCANNED), step=step, metadata=where)
        fused = terrain_map.update(again, PoseInOdom(np.eye(4), NO_DRIFT))
        assert np.isnan(fused.ceiling).all()


def test_a_height_that_is_uncertain_proves_no_way(
    robot: RobotModel, make_scan: MakeScan, where: dict[str, object]
) -> None:
    """The assumed error of a bound is that of accurate heights; other heights give no bound."""
    for sigma, count in ((0.0029, 48), (0.0031, 0)):
        terrain_map = gp.TerrainMap(robot)
        terrain = make_scan(0.0, flags=flags_of(make_scan), sigma=sigma, metadata=where)
        fused = terrain_map.update(terrain, PoseInOdom(np.eye(4), NO_DRIFT))
        hole = (fused.hazard & Hazard.DROPOUT) != 0
        assert np.isfinite(fused.ceiling[hole]).sum() == count


@pytest.mark.slow
def test_a_scan_that_saw_less_bounds_less(robot: RobotModel, make_scan: MakeScan, where: dict[str, object]) -> None:
    """Losing cells of a scan never lowers a bound and never creates one."""
    rng = np.random.default_rng(5)
    heights = 0.04 * (rng.random((11, 9)) < 0.15).repeat(10, 0).repeat(10, 1)[:108, :90]
    ceilings, unknown = [], []
    for lost in (0.0, 0.02, 0.3):
        terrain_map = gp.TerrainMap(robot)
        flags = np.where(np.random.default_rng(1).random(heights.shape) < lost, Hazard.DROPOUT, 0)
        terrain = make_scan(heights, flags=flags, metadata=where)
        fused = terrain_map.update(terrain, PoseInOdom(np.eye(4), NO_DRIFT))
        ceilings.append(np.where(np.isnan(h := fused.ceiling), np.inf, h))
        unknown.append(np.isnan(fused.elevation))
    for more, less in ((0, 1), (1, 2)):
        assert (ceilings[more] <= ceilings[less])[unknown[more]].all()
    bounded = [int(np.isfinite(each[unknown[0]]).sum()) for each in ceilings]
    assert bounded[0] > bounded[2] > 0


def test_ground_that_was_seen_is_no_higher_when_it_returns_nothing_later(
    robot: RobotModel, make_scan: MakeScan, where: dict[str, object]
) -> None:
    """The map forgets it, because it may be a hole; a swing may pass as low as over the earlier ground."""
    terrain_map = gp.TerrainMap(robot)
    first = make_scan(0.0, metadata=where)
    terrain_map.update(first, PoseInOdom(np.eye(4), NO_DRIFT))
    later = make_scan(0.0, flags=flags_of(make_scan), step=1, metadata=where)
    fused = terrain_map.update(later, PoseInOdom(np.eye(4), NO_DRIFT))
    hole = (fused.hazard & Hazard.DROPOUT) != 0
    assert hole.sum() == 48 and (np.abs(fused.ceiling[hole]) < 1e-6).all()
    low = over_the_hole(make_scan, 0.03)
    assert fused.check_path(low, 0.015).ok
    assert not fused.is_traversable(*low[0, :2] + (0, 0.06))


@pytest.mark.parametrize("between", [0.0, 0.050])
def test_no_bound_is_left_where_something_higher_was_seen_since(
    robot: RobotModel, make_scan: MakeScan, where: dict[str, object], between: float
) -> None:
    """A box is seen once and then returns nothing: no older bound is below its top."""
    terrain_map = gp.TerrainMap(robot)
    heights = np.zeros(make_scan(0.0).shape)
    heights[HOLE] = between
    # Other ground is not observed again, so that no newer light passes over the box.
    elsewhere = np.full(heights.shape, Hazard.UNSCANNED, np.uint16)
    elsewhere[HOLE] = 0
    for step, terrain in enumerate(
        (
            make_scan(0.0, metadata=where),
            make_scan(heights, flags=elsewhere, step=1, metadata=where),
            make_scan(flags=np.where(elsewhere, elsewhere, Hazard.DROPOUT), step=2, metadata=where),
        )
    ):
        fused = terrain_map.update(terrain, PoseInOdom(np.eye(4), NO_DRIFT))
        assert fused.step == step
    hole = (fused.hazard & Hazard.DROPOUT) != 0
    bounds = fused.ceiling[hole]
    assert hole.sum() == 48
    if between:
        assert (np.isnan(bounds) | (bounds >= between)).all()
    else:
        assert np.isfinite(bounds).all()


def test_each_cell_is_moved_by_what_it_may_have_drifted_itself(
    robot: RobotModel, make_scan: MakeScan, where: dict[str, object]
) -> None:
    """A heading error displaces far ground more than near ground, where more of a strip stays bounded."""
    terrain_map = gp.TerrainMap(robot)
    flags = np.full(make_scan(0.0).shape, Hazard.UNSCANNED, np.uint16)
    flags[40:68] = 0
    terrain = make_scan(0.0, flags=flags, metadata=where)
    terrain_map.update(terrain, PoseInOdom(np.eye(4), NO_DRIFT))
    nothing_seen = make_scan(flags=int(Hazard.DROPOUT), step=1, metadata=where)
    fused = terrain_map.update(nothing_seen, PoseInOdom(np.eye(4), np.diag([1e-12] * 5 + [0.01**2])))
    is_bounded = np.abs(fused.ceiling) < 1e-6
    x = fused.geometry.centres()[0]
    lost = []
    for at in (0.55, 0.85):
        column = np.abs(x - at).argmin()
        lost.append((28 - is_bounded[:, column].sum()) / 2)
        # By 2 sigma of the rotation, and half a cell of the map.
        assert lost[-1] >= np.ceil(2 * 0.01 * x[column] / 0.005 + 0.5)
    assert lost[0] < lost[1] < 14


@pytest.mark.parametrize(("at", "value"), [((0, 0), np.inf), ((70, 240), 0.1)])
def test_a_ceiling_that_is_none_is_refused(
    robot: RobotModel, make_scan: MakeScan, where: dict[str, object], at: tuple[int, int], value: float
) -> None:
    """An infinite ceiling, and a ceiling of ground with a known height."""
    fused = gp.TerrainMap(robot).update(make_scan(0.0, metadata=where), PoseInOdom(np.eye(4), NO_DRIFT))
    ceiling = fused.ceiling.copy()
    ceiling[at] = value
    with pytest.raises(gp.UnsafeGrid, match="ceiling is infinite, or set in a known cell: 1 cells"):
        dataclasses.replace(fused, layers={**fused.layers, "ceiling": ceiling})
