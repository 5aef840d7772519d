"""Rolling map: fusion, disagreement, lost observations, and undoing of updates."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import guara_perception as gp
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK, Hazard
from kinematics import LegOdometry, PoseInOdom, RobotModel, Stance
from tests.guara_perception.terrain.map.poses import AROUND, POINT, ZERO, MakeScan, at, drift, only
from tests.thorough import examples, further


def test_one_scan_comes_back_as_it_was(robot: RobotModel, make_scan: MakeScan) -> None:
    """At the origin, heights, flags and looks of the map equal those of its only scan."""
    rng = np.random.default_rng(0)
    scan = make_scan(rng.normal(0, 0.001, (108, 90)))
    fused = gp.TerrainMap(robot).update(scan, PoseInOdom(at(), ZERO))
    assert fused.extent == "map"
    assert fused.shape == (140, 320)
    window = fused.elevation[16:124, 220:310]
    np.testing.assert_array_equal(window, scan.elevation)
    assert (fused.looks[16:124, 220:310] == 1).all()
    assert np.isnan(fused.elevation[:, :219]).all()
    assert (fused.hazard[:, :219] & Hazard.UNSCANNED).all()


@pytest.mark.slow
def test_same_input_same_bytes(robot: RobotModel, make_scan: MakeScan) -> None:
    """Two maps with equal input are equal to the last bit, including metadata."""
    rng = np.random.default_rng(1)
    heights = rng.normal(0, 0.002, (5, 108, 90))
    ends = []
    for _ in range(2):
        terrain_map = gp.TerrainMap(robot)
        for step, layer in enumerate(heights):
            end = terrain_map.update(
                make_scan(layer, step=step), PoseInOdom(at(0.035 * step, 0, 0.02 * step), drift(0.001 * step))
            )
        ends.append(end)
    for name, layer in ends[0].layers.items():
        assert layer.tobytes() == ends[1].layer(name).tobytes()
    assert ends[0].metadata == ends[1].metadata


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, *further(1, 2, 3)])
def test_what_is_taken_back_leaves_no_trace(robot: RobotModel, make_scan: MakeScan, seed: int) -> None:
    """After updates since `keep` are undone, the map continues bit for bit as without them."""
    rng = np.random.default_rng(seed)
    with_trace, without = gp.TerrainMap(robot), gp.TerrainMap(robot)
    poses = [at(0.05 * step, 0.01 * step, 0.03 * step) for step in range(9)]
    for step in range(9):
        scan = make_scan(rng.normal(0, 0.003, (108, 90)), step=step, flags=rng.choice([0, 1, 4], p=[0.9, 0.05, 0.05]))
        ground = [gp.KnownGround([(0, -0.1), (0.4, -0.1), (0.4, 0.1)], 0.0, 0.002)] if step % 3 == 1 else []
        if step % 3 == 1:
            # The robot moved during this scan.
            with_trace.keep()
            with_trace.update(scan, PoseInOdom(poses[step], drift(0.001 * step)), known_ground=ground)
            with_trace.take_back()
            seen = with_trace.view(scan, PoseInOdom(poses[step], drift(0.001 * step)))
            assert not np.any((seen.hazard == 0) & (seen.looks > step))
            continue
        kept = with_trace.update(scan, PoseInOdom(poses[step], drift(0.001 * step)))
        expected = without.update(scan, PoseInOdom(poses[step], drift(0.001 * step)))
        for name, layer in expected.layers.items():
            assert layer.tobytes() == kept.layer(name).tobytes(), (step, name)
        assert kept.metadata == expected.metadata


def test_nothing_is_taken_back_that_was_not_kept(robot: RobotModel) -> None:
    """There is no state to restore; the message says what to call."""
    with pytest.raises(gp.InvalidInput, match=r"call keep\(\) first"):
        gp.TerrainMap(robot).take_back()


def test_equal_looks_are_averaged_and_the_variance_falls(robot: RobotModel, make_scan: MakeScan) -> None:
    """Many noisy observations are closer to the truth than one, as their variance predicts."""
    rng = np.random.default_rng(2)
    terrain_map = gp.TerrainMap(robot)
    for step in range(12):
        fused = terrain_map.update(
            make_scan(rng.normal(0, 0.001, (108, 90)), step=step, sigma=0.001), PoseInOdom(at(), ZERO)
        )
        if step == 0:
            first = fused
    inner = np.s_[30:110, 230:300]
    assert np.std(fused.elevation[inner]) < 0.4 * np.std(first.elevation[inner])
    assert np.median(fused.variance[inner]) < first.variance[inner].min() / 10
    assert (fused.looks[inner] == 12).mean() > 0.9
    # The rms error over cells is within what the variance predicts.
    pull = fused.elevation[inner] / np.sqrt(fused.variance[inner])
    assert np.sqrt(np.mean(pull**2)) < 1.2


def test_a_contradicting_look_is_a_conflict_until_two_agree(robot: RobotModel, make_scan: MakeScan) -> None:
    """20 mm instead of 0: CONFLICT, with both heights as lowest and highest; a second 20 mm resolves it."""
    terrain_map = gp.TerrainMap(robot)
    terrain_map.update(make_scan(0.0), PoseInOdom(at(), ZERO))
    disputed = terrain_map.update(make_scan(0.020, step=1), PoseInOdom(at(), ZERO))
    assert disputed.hazard_at(*POINT) & Hazard.CONFLICT
    assert not disputed.is_traversable(*POINT)
    iy, ix = (int(i) for i in disputed.geometry.indices(*POINT))
    assert disputed.elevation_min[iy, ix] == 0.0
    assert disputed.elevation_max[iy, ix] == np.float32(0.020)
    assert disputed.metadata["disagreeing_cells"] > 9000
    settled = terrain_map.update(make_scan(0.020, step=2), PoseInOdom(at(), ZERO))
    assert settled.hazard_at(*POINT) == Hazard.NONE
    assert settled.height_at(*POINT) == pytest.approx(0.020, abs=1e-4)
    assert settled.elevation_min[iy, ix] == pytest.approx(0.020, abs=1e-4)


def test_alternating_looks_stay_a_conflict(robot: RobotModel, make_scan: MakeScan) -> None:
    """0, 20, 0, 20 mm: no two in a row agree, so the conflict remains."""
    terrain_map = gp.TerrainMap(robot)
    for step, height in enumerate((0.0, 0.020, 0.0, 0.020)):
        fused = terrain_map.update(make_scan(height, step=step), PoseInOdom(at(), ZERO))
        assert bool(fused.hazard_at(*POINT) & Hazard.CONFLICT) == (step > 0)


@pytest.mark.parametrize("flag", [Hazard.DROPOUT, Hazard.AMBIGUOUS, Hazard.OUT_OF_RANGE])
def test_a_look_without_return_wins_over_what_was_known(
    robot: RobotModel, make_scan: MakeScan, scan_grid: Any, flag: Hazard
) -> None:
    """An observed cell without a return becomes unknown with its cause; a later return counts as new."""
    terrain_map = gp.TerrainMap(robot)
    for step in range(3):
        terrain_map.update(make_scan(0.0, step=step), PoseInOdom(at(), ZERO))
    lost = terrain_map.update(make_scan(0.0, flags=only(flag, scan_grid, AROUND), step=3), PoseInOdom(at(), ZERO))
    assert lost.hazard_at(*POINT) & flag
    assert np.isnan(lost.height_at(*POINT))
    back = terrain_map.update(make_scan(0.002, step=4), PoseInOdom(at(), ZERO))
    assert back.height_at(*POINT) == pytest.approx(0.002)
    iy, ix = (int(i) for i in back.geometry.indices(*POINT))
    assert back.looks[iy, ix] == 1


@pytest.mark.parametrize("flag", [Hazard.OCCLUDED, Hazard.UNSCANNED, Hazard.SELF])
def test_not_looked_at_keeps_the_height_and_ages_it(
    robot: RobotModel, make_scan: MakeScan, scan_grid: Any, flag: Hazard
) -> None:
    """If a cell is hidden, not fired or behind a leg, its height is kept and ages by one pause each time."""
    terrain_map = gp.TerrainMap(robot)
    terrain_map.update(make_scan(0.003), PoseInOdom(at(), ZERO))
    hidden = only(flag, scan_grid, AROUND)
    for step in (1, 2, 3):
        fused = terrain_map.update(make_scan(0.003, flags=hidden, step=step), PoseInOdom(at(), ZERO))
        iy, ix = (int(i) for i in fused.geometry.indices(*POINT))
        assert fused.height_at(*POINT) == pytest.approx(0.003)
        assert fused.age[iy, ix] == step
        assert fused.looks[iy, ix] == 1


def test_a_lost_frame_counts_as_looked_at(robot: RobotModel, make_scan: MakeScan, scan_grid: Any) -> None:
    """UNSCANNED cells of a lost stripe become DROPOUT in the map; those of a stripe that was not fired do not."""
    unscanned = only(Hazard.UNSCANNED, scan_grid, AROUND)
    columns = np.flatnonzero(unscanned.any(axis=0)).tolist()
    rows = np.flatnonzero(unscanned.any(axis=1))
    runs = [[ix, int(rows[0]), int(rows[-1]) + 1] for ix in columns]
    for metadata, expected in (({"lost_cells": runs}, Hazard.DROPOUT), ({}, Hazard.NONE)):
        terrain_map = gp.TerrainMap(robot)
        terrain_map.update(make_scan(0.0), PoseInOdom(at(), ZERO))
        fused = terrain_map.update(make_scan(0.0, flags=unscanned, step=1, metadata=metadata), PoseInOdom(at(), ZERO))
        assert fused.hazard_at(*POINT) & Hazard.DROPOUT == expected


@pytest.mark.slow
def test_a_blank_frame_of_a_recorded_scan_is_a_dropout_in_the_map(
    robot: RobotModel, calibration: gp.Calibration, paper_scan: gp.Scan, paper_terrain: gp.TerrainGrid
) -> None:
    """Frames 20 to 24 of the second scan are black: the cells in their view become unknown."""
    lost = gp.ScanProcessor(calibration, robot, paper_scan.stance, paper_scan.mode, step=1)
    for stripe, on, off in paper_scan.frames():
        lost.add(stripe.index, np.zeros_like(on) if stripe.index in (20, 22, 24) else on, off)
    scan = lost.finish()
    gone = np.isnan(scan.elevation) & np.isfinite(paper_terrain.elevation)
    assert gone.sum() > 800
    terrain_map = gp.TerrainMap(robot)
    terrain_map.update(paper_terrain, PoseInOdom(at(), ZERO))
    fused = terrain_map.update(scan, PoseInOdom(at(), ZERO))
    assert np.isnan(fused.elevation[16:124, 220:310][gone]).all()
    # The same scan without firing these stripes: known cells are kept.
    unfired = gp.ScanProcessor(calibration, robot, paper_scan.stance, paper_scan.mode, step=1)
    for stripe, on, off in paper_scan.frames():
        if stripe.index not in (20, 22, 24):
            unfired.add(stripe.index, on, off)
    terrain_map = gp.TerrainMap(robot)
    terrain_map.update(paper_terrain, PoseInOdom(at(), ZERO))
    kept = terrain_map.update(unfired.finish(), PoseInOdom(at(), ZERO))
    assert np.isfinite(kept.elevation[16:124, 220:310][gone]).mean() > 0.9


def test_occluded_ground_fills_in(robot: RobotModel, make_scan: MakeScan, scan_grid: Any) -> None:
    """Ground behind a box is OCCLUDED in the map until a scan from farther ahead observes it."""
    terrain_map = gp.TerrainMap(robot)
    hidden = only(Hazard.OCCLUDED, scan_grid, AROUND)
    first = terrain_map.update(make_scan(0.0, flags=hidden), PoseInOdom(at(), ZERO))
    assert first.hazard_at(*POINT) & Hazard.OCCLUDED
    second = terrain_map.update(make_scan(0.0, step=1), PoseInOdom(at(0.035), ZERO))
    assert second.height_at(POINT[0] - 0.035, POINT[1]) == 0.0


@pytest.mark.slow
@settings(max_examples=examples(15), deadline=None, derandomize=True)
@given(seed=st.integers(0, 1000))
def test_losing_returns_never_makes_the_fused_map_safer(robot: RobotModel, make_scan: MakeScan, seed: int) -> None:
    """An observation that loses returns leaves no cell safe that was not safe with them."""
    rng = np.random.default_rng(seed)
    heights = [np.where(rng.random((27, 30)) < 0.03, 0.03, 0.0).repeat(4, 0).repeat(3, 1) for _ in range(2)]
    lost = (rng.random((108, 90)) < 0.002).astype(np.uint16) * np.uint16(Hazard.DROPOUT)
    pose = at(0.05 * rng.random(), 0.05 * rng.random(), 0.3 * rng.random())
    results = []
    for flags in (0, lost):
        terrain_map = gp.TerrainMap(robot)
        terrain_map.update(make_scan(heights[0]), PoseInOdom(at(), ZERO))
        results.append(terrain_map.update(make_scan(heights[0], flags=flags, step=1), PoseInOdom(pose, ZERO)))
    with_all, with_lost = results
    assert not ((with_lost.hazard == 0) & (with_all.hazard != 0)).any()
    assert not ((with_lost.hazard == 0) & ((with_lost.hazard & UNKNOWN_MASK) != 0)).any()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"transform": np.eye(3)}, r"shape \(3, 3\); a finite \(4, 4\) matrix is needed"),
        ({"transform": np.diag([1, 1, 1, 2.0])}, "ends in the row"),
        ({"transform": np.diag([2, 1, 1, 1.0])}, "no rotation"),
        ({"transform": np.full((4, 4), np.nan)}, "a finite"),
        ({"transform": np.diag([1, -1, -1, 1.0])}, "tilts by more"),
        ({"covariance": np.zeros((3, 3))}, r"shape \(3, 3\); a finite \(6, 6\) matrix is needed"),
        ({"covariance": -np.eye(6)}, "covariance has a negative eigenvalue"),
        ({"step": 0}, "step 0 is not greater than 1"),
    ],
)
def test_bad_arguments_are_refused(
    robot: RobotModel, make_scan: MakeScan, change: dict[str, Any], message: str
) -> None:
    """A matrix that is not rigid, an invalid covariance and an earlier pause are rejected before any change."""
    terrain_map = gp.TerrainMap(robot)
    terrain_map.update(make_scan(0.0, step=1), PoseInOdom(at(), ZERO))
    with pytest.raises(gp.InvalidInput, match=message):
        terrain_map.update(
            make_scan(0.0, step=change.get("step", 2)),
            PoseInOdom(change.get("transform", at()), change.get("covariance", ZERO)),
        )
    assert terrain_map.update(make_scan(0.0, step=2), PoseInOdom(at(), ZERO)).metadata["scans"] == 2


def test_grids_of_another_kind_are_refused(robot: RobotModel, make_scan: MakeScan) -> None:
    """A map, cells of another size, and damaged runs of lost cells cannot be fused."""
    terrain_map = gp.TerrainMap(robot)
    fused = terrain_map.update(make_scan(0.0), PoseInOdom(at(), ZERO))
    with pytest.raises(gp.InvalidInput, match="extent 'map' cannot be fused"):
        terrain_map.update(fused, PoseInOdom(at(), ZERO))
    with pytest.raises(gp.InvalidInput, match="cells of 0.015 m; allowed: 0.005 m, as in the map"):
        terrain_map.update(make_scan(0.0, step=1).coarser(3), PoseInOdom(at(), ZERO))
    with pytest.raises(gp.InvalidInput, match="has lost_cells = "):
        terrain_map.update(make_scan(0.0, step=1, metadata={"lost_cells": [[1, 2]]}), PoseInOdom(at(), ZERO))
    with pytest.raises(gp.InvalidInput, match="a scan of robot 'tapir' in frame 'base_footprint' cannot be fused"):
        terrain_map.update(make_scan(0.0, step=1).restated(robot="tapir"), PoseInOdom(at(), ZERO))
    with pytest.raises(gp.InvalidInput, match="in frame 'odom' cannot be fused; allowed: 'guara', 'base_footprint'"):
        terrain_map.update(replace(make_scan(0.0, step=1), frame="odom"), PoseInOdom(at(), ZERO))
    with pytest.raises(gp.StaleTerrain, match="of a dead run"):
        terrain_map.update(replace(make_scan(0.0, step=1), stale_because=("of a dead run",)), PoseInOdom(at(), ZERO))


def test_a_pose_of_leg_odometry_is_taken_to_the_footprint_of_the_scan(robot: RobotModel, make_scan: MakeScan) -> None:
    """For a scan levelled by its support plane, 0.05 rad off, the pose is that of its own footprint."""
    joints = robot.posture(robot.config.scan_posture)
    pose = LegOdometry(robot).update(Stance(joints, tuple(robot.legs), (0.0, 0.0, -1.0)))
    tilted = np.array(pose.pose.transform_base_to_footprint)
    tilted[:3, :3] = [[np.cos(0.05), 0, np.sin(0.05)], [0, 1, 0], [-np.sin(0.05), 0, np.cos(0.05)]] @ tilted[:3, :3]
    scan = make_scan(0.0, metadata={"transform_base_to_footprint": tilted.tolist()})
    transform = pose.transform_base_to_odom @ np.linalg.inv(tilted)
    own = PoseInOdom(transform, pose.covariance, pose.covariance_since_last, pose.own_covariance)
    one, two = (gp.TerrainMap(robot).update(scan, each) for each in (pose, own))
    np.testing.assert_allclose(one.elevation, two.elevation, atol=1e-9)
    found, wanted = (np.array(each.metadata["transform_footprint_to_odom"]) for each in (one, two))
    np.testing.assert_allclose(found, wanted, atol=1e-12)
    assert abs(found[2, 0]) == pytest.approx(np.sin(0.05), abs=1e-6)
