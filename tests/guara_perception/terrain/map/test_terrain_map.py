"""The rolling map: fusion, disagreement, lost looks, ageing, feet, declared ground; it stands still in odom."""

from __future__ import annotations

import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import guara_perception as gp
from guara_perception.settings import Settings
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK, Hazard
from kinematics import RobotModel

MakeScan = Any
ZERO = np.zeros((6, 6))
# A point in the middle of a scan taken at the origin, in odom.
PLACE = (0.7025, 0.0025)


def at(x: float = 0.0, y: float = 0.0, yaw: float = 0.0, z: float = 0.0) -> np.ndarray:
    """transform_footprint_to_odom."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s, 0, x], [s, c, 0, y], [0, 0, 1, z], [0, 0, 0, 1.0]])


def drift(rise: float = 0.0, shift: float = 0.0, turn: float = 0.0) -> np.ndarray:
    """Covariance of odometry from standard deviations."""
    return np.diag([shift**2, shift**2, rise**2, 0, 0, turn**2])


def only(flag: Hazard, scan_grid: Any, box: tuple[float, float, float, float]) -> np.ndarray:
    """Flags that are set within x0 ... x1, y0 ... y1."""
    x, y = scan_grid.centres()
    inside = (x >= box[0]) & (x < box[1]) & ((y >= box[2]) & (y < box[3]))[:, None]
    return np.where(inside, np.uint16(flag), 0).astype(np.uint16)


AROUND = (0.68, 0.72, -0.02, 0.02)


def test_one_scan_comes_back_as_it_was(robot: RobotModel, make_scan: MakeScan) -> None:
    """At the origin, cell for cell: heights, flags and looks of the map are those of its only scan."""
    rng = np.random.default_rng(0)
    scan = make_scan(rng.normal(0, 0.001, (108, 90)))
    fused = gp.TerrainMap(robot).update(scan, at(), ZERO)
    assert fused.extent == "map"
    assert fused.shape == (140, 320)
    window = fused.elevation[16:124, 220:310]
    np.testing.assert_array_equal(window, scan.elevation)
    assert (fused.looks[16:124, 220:310] == 1).all()
    assert np.isnan(fused.elevation[:, :219]).all()
    assert (fused.hazard[:, :219] & Hazard.UNSCANNED).all()


def test_same_input_same_bytes(robot: RobotModel, make_scan: MakeScan) -> None:
    """Two maps fed alike are alike to the last bit, metadata too."""
    rng = np.random.default_rng(1)
    heights = rng.normal(0, 0.002, (5, 108, 90))
    ends = []
    for _ in range(2):
        terrain_map = gp.TerrainMap(robot)
        for step, layer in enumerate(heights):
            end = terrain_map.update(make_scan(layer, step=step), at(0.035 * step, 0, 0.02 * step), drift(0.001 * step))
        ends.append(end)
    for name, layer in ends[0].layers.items():
        assert layer.tobytes() == ends[1].layer(name).tobytes()
    assert ends[0].metadata == ends[1].metadata


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_what_is_taken_back_leaves_no_trace(robot: RobotModel, make_scan: MakeScan, seed: int) -> None:
    """Scans fused after `keep` and taken back: the map goes on bit for bit as if they had never been."""
    rng = np.random.default_rng(seed)
    with_trace, without = gp.TerrainMap(robot), gp.TerrainMap(robot)
    poses = [at(0.05 * step, 0.01 * step, 0.03 * step) for step in range(9)]
    for step in range(9):
        scan = make_scan(rng.normal(0, 0.003, (108, 90)), step=step, flags=rng.choice([0, 1, 4], p=[0.9, 0.05, 0.05]))
        ground = [gp.KnownGround([(0, -0.1), (0.4, -0.1), (0.4, 0.1)], 0.0, 0.002)] if step % 3 == 1 else []
        if step % 3 == 1:
            # The robot moved during this one.
            with_trace.keep()
            with_trace.update(scan, poses[step], drift(0.001 * step), known_ground=ground)
            with_trace.take_back()
            seen = with_trace.view(scan, poses[step], drift(0.001 * step))
            assert not np.any((seen.hazard == 0) & (seen.looks > step))
            continue
        kept = with_trace.update(scan, poses[step], drift(0.001 * step))
        expected = without.update(scan, poses[step], drift(0.001 * step))
        for name, layer in expected.layers.items():
            assert layer.tobytes() == kept.layer(name).tobytes(), (step, name)
        assert kept.metadata == expected.metadata


def test_nothing_is_taken_back_that_was_not_kept(robot: RobotModel) -> None:
    """There is nothing to come back to; the message says what to call."""
    with pytest.raises(gp.InvalidInput, match=r"call keep\(\) first"):
        gp.TerrainMap(robot).take_back()


def test_time_that_runs_backwards_makes_what_was_seen_before_stale(robot: RobotModel, make_scan: MakeScan) -> None:
    """A clock set back by an hour: how old the cells are, is not known, so they count as old; and it is said."""
    terrain_map = gp.TerrainMap(robot)
    terrain_map.update(make_scan(0.0, stamp=10_000 * 10**9), at(), ZERO)
    away = at(0.3)
    later = terrain_map.update(make_scan(0.0, step=1, stamp=(10_000 + 1_000 - 3_600) * 10**9), away, ZERO)
    old = np.isfinite(later.elevation) & (later.age > 0)
    assert old.any() and ((later.hazard[old] & Hazard.STALE) != 0).all()
    assert any("went back by 2.6e+03 s" in reason for reason in later.metadata["health"]["reasons"])


def test_cells_age_by_the_clock_that_is_given(robot: RobotModel, make_scan: MakeScan) -> None:
    """The wall clock was set back, a clock that never steps was not: 1,000 s are more than the validity of 420 s."""
    terrain_map = gp.TerrainMap(robot)
    terrain_map.update(make_scan(0.0, stamp=10_000 * 10**9), at(), ZERO, time=50.0)
    later = terrain_map.update(make_scan(0.0, step=1, stamp=7_400 * 10**9), at(0.3), ZERO, time=1_050.0)
    old = np.isfinite(later.elevation) & (later.age > 0)
    assert old.any() and ((later.hazard[old] & Hazard.STALE) != 0).all()
    assert later.metadata["health"]["level"] == "ok"


def test_equal_looks_are_averaged_and_the_variance_falls(robot: RobotModel, make_scan: MakeScan) -> None:
    """Many noisy looks end nearer to the truth than one, with a variance that says so."""
    rng = np.random.default_rng(2)
    terrain_map = gp.TerrainMap(robot)
    for step in range(12):
        fused = terrain_map.update(make_scan(rng.normal(0, 0.001, (108, 90)), step=step, sigma=0.001), at(), ZERO)
        if step == 0:
            first = fused
    inner = np.s_[30:110, 230:300]
    assert np.std(fused.elevation[inner]) < 0.4 * np.std(first.elevation[inner])
    assert np.median(fused.variance[inner]) < first.variance[inner].min() / 10
    assert (fused.looks[inner] == 12).mean() > 0.9
    # The truth lies within what the variance promises, in the root mean square over cells.
    pull = fused.elevation[inner] / np.sqrt(fused.variance[inner])
    assert np.sqrt(np.mean(pull**2)) < 1.2


def test_a_contradicting_look_is_a_conflict_until_two_agree(robot: RobotModel, make_scan: MakeScan) -> None:
    """20 mm instead of 0: CONFLICT, both heights kept as lowest and highest; a second 20 mm settles it."""
    terrain_map = gp.TerrainMap(robot)
    terrain_map.update(make_scan(0.0), at(), ZERO)
    disputed = terrain_map.update(make_scan(0.020, step=1), at(), ZERO)
    assert disputed.hazard_at(*PLACE) & Hazard.CONFLICT
    assert not disputed.is_traversable(*PLACE)
    iy, ix = (int(i) for i in disputed.geometry.indices(*PLACE))
    assert disputed.elevation_min[iy, ix] == 0.0
    assert disputed.elevation_max[iy, ix] == np.float32(0.020)
    assert disputed.metadata["disagreeing_cells"] > 9000
    settled = terrain_map.update(make_scan(0.020, step=2), at(), ZERO)
    assert settled.hazard_at(*PLACE) == Hazard.NONE
    assert settled.height_at(*PLACE) == pytest.approx(0.020, abs=1e-4)
    assert settled.elevation_min[iy, ix] == pytest.approx(0.020, abs=1e-4)


def test_alternating_looks_stay_a_conflict(robot: RobotModel, make_scan: MakeScan) -> None:
    """0, 20, 0, 20 mm: no two in a row agree, so it stays a conflict; the third look's zero does not clear it."""
    terrain_map = gp.TerrainMap(robot)
    for step, height in enumerate((0.0, 0.020, 0.0, 0.020)):
        fused = terrain_map.update(make_scan(height, step=step), at(), ZERO)
        assert bool(fused.hazard_at(*PLACE) & Hazard.CONFLICT) == (step > 0)


@pytest.mark.parametrize("flag", [Hazard.DROPOUT, Hazard.AMBIGUOUS, Hazard.OUT_OF_RANGE])
def test_a_look_without_return_wins_over_what_was_known(
    robot: RobotModel, make_scan: MakeScan, scan_grid: Any, flag: Hazard
) -> None:
    """Visible again and no return: unknown with that cause, whatever was known; a later return is taken as new."""
    terrain_map = gp.TerrainMap(robot)
    for step in range(3):
        terrain_map.update(make_scan(0.0, step=step), at(), ZERO)
    lost = terrain_map.update(make_scan(0.0, flags=only(flag, scan_grid, AROUND), step=3), at(), ZERO)
    assert lost.hazard_at(*PLACE) & flag
    assert np.isnan(lost.height_at(*PLACE))
    back = terrain_map.update(make_scan(0.002, step=4), at(), ZERO)
    assert back.height_at(*PLACE) == pytest.approx(0.002)
    iy, ix = (int(i) for i in back.geometry.indices(*PLACE))
    assert back.looks[iy, ix] == 1


@pytest.mark.parametrize("flag", [Hazard.OCCLUDED, Hazard.UNSCANNED, Hazard.SELF])
def test_not_looked_at_keeps_the_height_and_ages_it(
    robot: RobotModel, make_scan: MakeScan, scan_grid: Any, flag: Hazard
) -> None:
    """Hidden, not fired or behind a leg: the old height stands, one pause older each time."""
    terrain_map = gp.TerrainMap(robot)
    terrain_map.update(make_scan(0.003), at(), ZERO)
    hidden = only(flag, scan_grid, AROUND)
    for step in (1, 2, 3):
        fused = terrain_map.update(make_scan(0.003, flags=hidden, step=step), at(), ZERO)
        iy, ix = (int(i) for i in fused.geometry.indices(*PLACE))
        assert fused.height_at(*PLACE) == pytest.approx(0.003)
        assert fused.age[iy, ix] == step
        assert fused.looks[iy, ix] == 1


def test_a_lost_frame_counts_as_looked_at(robot: RobotModel, make_scan: MakeScan, scan_grid: Any) -> None:
    """UNSCANNED cells of a stripe that was fired and lost become DROPOUT in the map; of one never fired they stay."""
    unscanned = only(Hazard.UNSCANNED, scan_grid, AROUND)
    columns = np.flatnonzero(unscanned.any(axis=0)).tolist()
    rows = np.flatnonzero(unscanned.any(axis=1))
    runs = [[ix, int(rows[0]), int(rows[-1]) + 1] for ix in columns]
    for metadata, expected in (({"lost_cells": runs}, Hazard.DROPOUT), ({}, Hazard.NONE)):
        terrain_map = gp.TerrainMap(robot)
        terrain_map.update(make_scan(0.0), at(), ZERO)
        fused = terrain_map.update(make_scan(0.0, flags=unscanned, step=1, metadata=metadata), at(), ZERO)
        assert fused.hazard_at(*PLACE) & Hazard.DROPOUT == expected


@pytest.mark.slow
def test_a_blank_frame_of_a_recorded_scan_is_a_dropout_in_the_map(
    robot: RobotModel, calibration: gp.Calibration, paper_scan: gp.Scan, paper_terrain: gp.TerrainGrid
) -> None:
    """Frames 20 to 24 of the second scan are black: what they would have seen is known no longer."""
    lost = gp.ScanProcessor(calibration, robot, paper_scan.stance, paper_scan.mode, step=1)
    for stripe, on, off in paper_scan.frames():
        lost.add(stripe.index, np.zeros_like(on) if stripe.index in (20, 22, 24) else on, off)
    scan = lost.finish()
    gone = np.isnan(scan.elevation) & np.isfinite(paper_terrain.elevation)
    assert gone.sum() > 800
    terrain_map = gp.TerrainMap(robot)
    terrain_map.update(paper_terrain, at(), ZERO)
    fused = terrain_map.update(scan, at(), ZERO)
    assert np.isnan(fused.elevation[16:124, 220:310][gone]).all()
    # The same scan with these stripes never fired: what was known stays.
    unfired = gp.ScanProcessor(calibration, robot, paper_scan.stance, paper_scan.mode, step=1)
    for stripe, on, off in paper_scan.frames():
        if stripe.index not in (20, 22, 24):
            unfired.add(stripe.index, on, off)
    terrain_map = gp.TerrainMap(robot)
    terrain_map.update(paper_terrain, at(), ZERO)
    kept = terrain_map.update(unfired.finish(), at(), ZERO)
    assert np.isfinite(kept.elevation[16:124, 220:310][gone]).mean() > 0.9


def test_occluded_ground_fills_in(robot: RobotModel, make_scan: MakeScan, scan_grid: Any) -> None:
    """What a box hid is OCCLUDED in the map until a scan from further on sees it."""
    terrain_map = gp.TerrainMap(robot)
    hidden = only(Hazard.OCCLUDED, scan_grid, AROUND)
    first = terrain_map.update(make_scan(0.0, flags=hidden), at(), ZERO)
    assert first.hazard_at(*PLACE) & Hazard.OCCLUDED
    second = terrain_map.update(make_scan(0.0, step=1), at(0.035), ZERO)
    assert second.height_at(PLACE[0] - 0.035, PLACE[1]) == 0.0


def test_ground_turns_stale_by_pauses_and_by_seconds(robot: RobotModel, make_scan: MakeScan, scan_grid: Any) -> None:
    """Beyond the validity of robot.toml in either measure a height is STALE; a new look makes it fresh."""
    validity = Settings.of(robot)
    hidden = only(Hazard.UNSCANNED, scan_grid, AROUND)
    by_pauses = gp.TerrainMap(robot)
    by_pauses.update(make_scan(0.0, step=0, stamp=1), at(), ZERO)
    last = validity.validity_pauses
    still = by_pauses.update(make_scan(0.0, flags=hidden, step=last, stamp=2), at(), ZERO)
    assert still.hazard_at(*PLACE) == Hazard.NONE
    stale = by_pauses.update(make_scan(0.0, flags=hidden, step=last + 1, stamp=3), at(), ZERO)
    assert stale.hazard_at(*PLACE) & Hazard.STALE
    assert stale.height_at(*PLACE) == 0.0
    fresh = by_pauses.update(make_scan(0.0, step=last + 2, stamp=4), at(), ZERO)
    assert fresh.hazard_at(*PLACE) == Hazard.NONE
    by_seconds = gp.TerrainMap(robot)
    by_seconds.update(make_scan(0.0, step=0, stamp=10**9), at(), ZERO)
    late = 10**9 + int((validity.validity_seconds + 1) * 1e9)
    assert (
        by_seconds.update(make_scan(0.0, flags=hidden, step=1, stamp=late), at(), ZERO).hazard_at(*PLACE) & Hazard.STALE
    )


def test_validity_outlasts_what_a_hind_foot_needs(robot: RobotModel) -> None:
    """Nine cycles of four pauses at 18.7 s each."""
    validity = Settings.of(robot)
    assert validity.validity_pauses >= 36
    assert validity.validity_seconds >= 9 * 18.7


@pytest.mark.slow
@settings(max_examples=12, deadline=None, derandomize=True)
@given(yaw=st.floats(-np.pi, np.pi), x=st.floats(-3, 3), y=st.floats(-3, 3), z=st.floats(-0.2, 0.2))
def test_a_look_from_anywhere_comes_back_in_place(
    robot: RobotModel, make_scan: MakeScan, scan_grid: Any, yaw: float, x: float, y: float, z: float
) -> None:
    """Turned and shifted by anything, a map of one scan shows each height within a cell and a half of where it lies."""
    gx, gy = np.meshgrid(*scan_grid.centres())
    fused = gp.TerrainMap(robot).update(make_scan(0.1 * gx - 0.2 * gy), at(x, y, yaw, z), ZERO)
    inner = fused.elevation[30:110, 235:295].astype(np.float64)
    fx, fy = np.meshgrid(*fused.geometry.centres())
    expected = (0.1 * fx - 0.2 * fy)[30:110, 235:295]
    assert np.isfinite(inner).all()
    assert np.abs(inner - expected).max() < 0.3 * 1.5 * 0.005


def test_a_scan_that_was_levelled_otherwise_is_turned_upright(
    robot: RobotModel, make_scan: MakeScan, scan_grid: Any
) -> None:
    """Ground seen from a footprint that tilts by 5 degrees: level in odom, and tilted again in the snapshot."""
    gx, gy = np.meshgrid(*scan_grid.centres())
    tilt = np.radians(5)
    tilted = np.eye(4)
    tilted[:3, :3] = [[np.cos(tilt), 0, np.sin(tilt)], [0, 1, 0], [-np.sin(tilt), 0, np.cos(tilt)]]
    terrain_map = gp.TerrainMap(robot)
    fused = terrain_map.update(make_scan(np.tan(tilt) * gx), tilted, ZERO)
    fx, _ = np.meshgrid(*fused.geometry.centres())
    seen = np.isfinite(fused.elevation)
    assert seen.sum() > 9000
    np.testing.assert_allclose(fused.elevation[seen], np.tan(tilt) * fx[seen], atol=4e-4)
    nothing = np.full(scan_grid.shape, np.uint16(Hazard.UNSCANNED))
    upright = terrain_map.update(make_scan(0.0, flags=nothing, step=1), at(), ZERO)
    assert np.nanmax(np.abs(upright.elevation)) < 4e-4


def test_cells_stand_still_in_odom(robot: RobotModel, make_scan: MakeScan, scan_grid: Any) -> None:
    """A height seen once keeps its exact value over a walk: nothing is resampled."""
    rng = np.random.default_rng(3)
    heights = rng.normal(0, 0.003, (108, 90))
    terrain_map = gp.TerrainMap(robot)
    before = terrain_map.update(make_scan(heights), at(), ZERO)
    nothing = np.full(scan_grid.shape, np.uint16(Hazard.UNSCANNED))
    for step in range(1, 21):
        after = terrain_map.update(make_scan(0.0, flags=nothing, step=step), at(0.035 * step), ZERO)
    # 20 * 35 mm are 140 cells of 5 mm.
    np.testing.assert_array_equal(after.elevation[16:124, 80:170], before.elevation[16:124, 220:310])


def test_what_lies_far_behind_is_forgotten_and_memory_does_not_grow(robot: RobotModel, make_scan: MakeScan) -> None:
    """After 5 m the first scan is gone for good, even when the robot comes back; the arrays are as large as before."""
    terrain_map = gp.TerrainMap(robot)
    terrain_map.update(make_scan(0.004), at(), ZERO)
    size = sum(array.nbytes for array in terrain_map._cells.memory.values())
    unscanned = np.full((108, 90), np.uint16(Hazard.UNSCANNED))
    for step in range(1, 21):
        terrain_map.update(make_scan(0.0, flags=unscanned, step=step), at(0.25 * step), ZERO)
    back = terrain_map.update(make_scan(0.0, flags=unscanned, step=21), at(), ZERO)
    assert np.isnan(back.elevation).all()
    assert sum(array.nbytes for array in terrain_map._cells.memory.values()) == size
    assert size < 40e6


def test_a_snapshot_joins_the_flags_of_cells_touched(robot: RobotModel, make_scan: MakeScan, scan_grid: Any) -> None:
    """Half a cell further on, a cell that touches one without return is unknown itself: two columns instead of one."""
    hole = only(Hazard.DROPOUT, scan_grid, (0.70, 0.705, 0.0, 0.005))
    terrain_map = gp.TerrainMap(robot)
    whole = terrain_map.update(make_scan(0.0, flags=hole), at(), ZERO)
    nothing = np.full(scan_grid.shape, np.uint16(Hazard.UNSCANNED))
    shifted = terrain_map.update(make_scan(0.0, flags=nothing, step=1), at(0.0025, 0.0025), ZERO)
    inside = np.s_[40:100, 240:290]
    assert np.isnan(whole.elevation[inside]).sum() == 1
    assert np.isnan(shifted.elevation[inside]).sum() == 4


@pytest.mark.slow
def test_no_narrow_bump_slips_between_nearest_cells(robot: RobotModel, make_scan: MakeScan, scan_grid: Any) -> None:
    """A bump of one cell stays in elevation_max whatever the heading of the snapshot."""
    gx, gy = np.meshgrid(*scan_grid.centres())
    bump = np.where((np.abs(gx - 0.7025) < 1e-3) & (np.abs(gy - 0.0025) < 1e-3), 0.04, 0.0)
    nothing = np.full(scan_grid.shape, np.uint16(Hazard.UNSCANNED))
    for yaw in np.linspace(0.02, 0.5, 12):
        terrain_map = gp.TerrainMap(robot)
        terrain_map.update(make_scan(bump), at(), ZERO)
        turned = terrain_map.update(make_scan(0.0, flags=nothing, step=1), at(0.1, 0.0, yaw), ZERO)
        assert np.nanmax(turned.elevation_max) == np.float32(0.04)


def test_variance_grows_with_travel(robot: RobotModel, make_scan: MakeScan, scan_grid: Any) -> None:
    """What is not seen gains the variance that odometry gains in z; on a slope its sideways drift too."""
    gx, _ = np.meshgrid(*scan_grid.centres())
    nothing = np.full(scan_grid.shape, np.uint16(Hazard.UNSCANNED))
    grown = {}
    for name, heights in (("flat", 0.0), ("slope", 0.2 * gx)):
        terrain_map = gp.TerrainMap(robot)
        terrain_map.update(make_scan(heights), at(), ZERO)
        after = terrain_map.update(make_scan(0.0, flags=nothing, step=1), at(), drift(0.002, 0.004))
        iy, ix = (int(i) for i in after.geometry.indices(*PLACE))
        grown[name] = float(after.variance[iy, ix])
    assert grown["flat"] == pytest.approx(0.002**2 + 0.0002**2 + 0.0005**2, rel=0.01)
    assert grown["slope"] - grown["flat"] == pytest.approx((0.2 * 0.004) ** 2 + 0.2**2 * 0.005**2 / 12, rel=0.02)


def test_tilt_of_the_stance_makes_far_cells_less_sure(robot: RobotModel, make_scan: MakeScan) -> None:
    """A pitch that is known to 0.2 degrees lifts a point at x by x times that."""
    covariance = np.zeros((6, 6))
    covariance[4, 4] = np.radians(0.2) ** 2
    scan = make_scan(0.0, metadata={"pose_covariance": covariance.tolist()})
    fused = gp.TerrainMap(robot).update(scan, at(), ZERO)
    for x in (0.55, 0.90):
        iy, ix = (int(i) for i in fused.geometry.indices(x, 0.0))
        expected = (np.radians(0.2) * fused.geometry.centres()[0][ix]) ** 2 + 0.0002**2 + 0.0005**2
        assert fused.variance[iy, ix] == pytest.approx(expected, rel=0.01)


def stance_metadata(robot: RobotModel) -> dict[str, Any]:
    """Metadata of the scan posture on level ground."""
    from kinematics import Stance

    stance = Stance(robot.posture("scan"), robot.legs, (0, 0, -1))
    pose = robot.stance_pose(stance)
    return {
        "stance": stance.to_dict(),
        "transform_base_to_footprint": pose.transform_base_to_footprint.tolist(),
        "support_feet_used": list(robot.legs),
    }


def test_soles_make_ground_known_that_no_scan_saw(robot: RobotModel, make_scan: MakeScan) -> None:
    """Under each sole z = 0 is known, with looks 0; a step away nothing is; no such cell is traversable by itself."""
    fused = gp.TerrainMap(robot).update(make_scan(0.0, metadata=stance_metadata(robot)), at(), ZERO)
    for x in (-0.3, 0.3):
        for y in (-0.18, 0.18):
            assert fused.height_at(x, y) == pytest.approx(0.0, abs=1e-6)
            iy, ix = (int(i) for i in fused.geometry.indices(x, y))
            assert fused.looks[iy, ix] == 0
            assert not fused.is_traversable(x, y)
            assert np.isnan(fused.height_at(x, y + 0.05))
    assert set(fused.metadata["support_residuals"]) == set(robot.legs)
    assert all(residual is None for residual in fused.metadata["support_residuals"].values())


def test_the_residual_of_each_sole_is_published_and_holds_the_height(robot: RobotModel, make_scan: MakeScan) -> None:
    """The map lies 3 mm below the soles, odometry unsure: residuals of 3 mm, and the walk's height is corrected."""
    terrain_map = gp.TerrainMap(robot)
    # Two scans from behind bring the ground under all four feet into the map.
    for step, x in enumerate((-1.1, -0.75, -0.5)):
        terrain_map.update(make_scan(0.0, step=step), at(x), ZERO)
    pause = make_scan(0.0, step=3, metadata=stance_metadata(robot))
    fused = terrain_map.update(pause, at(0.0, z=0.003), drift(0.01))
    residuals = fused.metadata["support_residuals"]
    assert all(residual == pytest.approx(0.003, abs=3e-4) for residual in residuals.values() if residual is not None)
    assert sum(residual is not None for residual in residuals.values()) == 4
    assert fused.metadata["height_correction"] == pytest.approx(-0.003, abs=3e-4)
    assert fused.metadata["transform_footprint_to_odom"][2][3] == pytest.approx(0.0, abs=3e-4)
    assert fused.height_at(-0.3, 0.18) == pytest.approx(0.0, abs=5e-4)


def test_a_sole_that_stands_far_off_is_not_used_but_named(robot: RobotModel, make_scan: MakeScan) -> None:
    """20 mm are no drift of 1 mm: nothing is shifted, and the map's health says which soles."""
    terrain_map = gp.TerrainMap(robot)
    for step, x in enumerate((-1.1, -0.75, -0.5)):
        terrain_map.update(make_scan(0.0, step=step), at(x), ZERO)
    pause = make_scan(0.0, step=3, metadata=stance_metadata(robot))
    fused = terrain_map.update(pause, at(0.0, z=0.020), drift(0.001))
    assert fused.metadata["height_correction"] == 0.0
    assert fused.metadata["health"]["level"] == "degraded"
    assert any("the sole of lf stands +20" in reason for reason in fused.metadata["health"]["reasons"])


def test_declared_ground_is_known_and_marked(robot: RobotModel, make_scan: MakeScan, scan_grid: Any) -> None:
    """Inside the polygon only, at its height and sigma, looks 0, listed in the metadata; a scan's word counts more."""
    ground = gp.KnownGround(np.array([[-0.5, -0.3], [0.45, -0.3], [0.45, 0.3], [-0.5, 0.3]]), 0.0, 0.002)
    dark = only(Hazard.DROPOUT, scan_grid, AROUND)
    fused = gp.TerrainMap(robot).update(make_scan(0.0, flags=dark), at(), ZERO, known_ground=[ground])
    assert fused.height_at(0.0, 0.0) == 0.0
    assert fused.is_traversable(0.0, 0.0)
    iy, ix = (int(i) for i in fused.geometry.indices(0.0, 0.0))
    assert fused.looks[iy, ix] == 0
    assert np.sqrt(fused.variance[iy, ix]) == pytest.approx(0.002)
    assert np.isnan(fused.height_at(0.475, 0.0))
    assert np.isnan(fused.height_at(-0.55, 0.0))
    (patch,) = fused.metadata["known_ground"]
    assert patch["step"] == 0
    assert patch["cells"] == 190 * 120
    everywhere = gp.KnownGround(np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]), 0.05, 0.0)
    over = gp.TerrainMap(robot).update(make_scan(0.0, flags=dark), at(), ZERO, known_ground=[everywhere])
    assert over.height_at(0.6, 0.1) == 0.0
    assert over.hazard_at(*PLACE) & Hazard.DROPOUT


def test_declared_ground_that_a_scan_contradicts_is_a_conflict(robot: RobotModel, make_scan: MakeScan) -> None:
    """The gait said 0, the scan sees 30 mm: CONFLICT until a second look agrees with the first."""
    terrain_map = gp.TerrainMap(robot)
    nothing = np.full((108, 90), np.uint16(Hazard.UNSCANNED))
    ground = gp.KnownGround(np.array([[0.5, -0.2], [0.9, -0.2], [0.9, 0.2], [0.5, 0.2]]), 0.0, 0.001)
    terrain_map.update(make_scan(0.0, flags=nothing), at(), ZERO, known_ground=[ground])
    assert terrain_map.update(make_scan(0.03, step=1), at(), ZERO).hazard_at(*PLACE) & Hazard.CONFLICT
    assert terrain_map.update(make_scan(0.03, step=2), at(), ZERO).height_at(*PLACE) == pytest.approx(0.03, abs=1e-4)


@pytest.mark.slow
@settings(max_examples=15, deadline=None, derandomize=True)
@given(seed=st.integers(0, 1000))
def test_losing_returns_never_makes_the_fused_map_safer(robot: RobotModel, make_scan: MakeScan, seed: int) -> None:
    """A look that loses returns (looked at, nothing seen) leaves no cell safe that was not safe with them."""
    rng = np.random.default_rng(seed)
    heights = [np.where(rng.random((27, 30)) < 0.03, 0.03, 0.0).repeat(4, 0).repeat(3, 1) for _ in range(2)]
    lost = (rng.random((108, 90)) < 0.002).astype(np.uint16) * np.uint16(Hazard.DROPOUT)
    pose = at(0.05 * rng.random(), 0.05 * rng.random(), 0.3 * rng.random())
    results = []
    for flags in (0, lost):
        terrain_map = gp.TerrainMap(robot)
        terrain_map.update(make_scan(heights[0]), at(), ZERO)
        results.append(terrain_map.update(make_scan(heights[0], flags=flags, step=1), pose, ZERO))
    with_all, with_lost = results
    assert not ((with_lost.hazard == 0) & (with_all.hazard != 0)).any()
    assert not ((with_lost.hazard == 0) & ((with_lost.hazard & UNKNOWN_MASK) != 0)).any()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"transform": np.eye(3)}, r"shape \(3, 3\), it must be a rigid \(4, 4\)"),
        ({"transform": np.diag([1, 1, 1, 2.0])}, "rigid"),
        ({"transform": np.diag([2, 1, 1, 1.0])}, "no rotation"),
        ({"transform": np.full((4, 4), np.nan)}, "rigid"),
        ({"transform": np.diag([1, -1, -1, 1.0])}, "tilts by more"),
        ({"covariance": np.zeros((3, 3))}, r"shape \(3, 3\), it must be \(6, 6\)"),
        ({"covariance": -np.eye(6)}, "positive diagonal"),
        ({"step": 0}, "step 0 comes after step 1"),
    ],
)
def test_bad_arguments_are_refused(
    robot: RobotModel, make_scan: MakeScan, change: dict[str, Any], message: str
) -> None:
    """No rigid transform, no covariance, an earlier pause: refused before anything changes."""
    terrain_map = gp.TerrainMap(robot)
    terrain_map.update(make_scan(0.0, step=1), at(), ZERO)
    with pytest.raises(gp.InvalidInput, match=message):
        terrain_map.update(
            make_scan(0.0, step=change.get("step", 2)), change.get("transform", at()), change.get("covariance", ZERO)
        )
    assert terrain_map.update(make_scan(0.0, step=2), at(), ZERO).metadata["scans"] == 2


def test_grids_of_another_kind_are_refused(robot: RobotModel, make_scan: MakeScan) -> None:
    """A map cannot be fused into a map, nor cells of another size, nor damaged runs of lost cells."""
    terrain_map = gp.TerrainMap(robot)
    fused = terrain_map.update(make_scan(0.0), at(), ZERO)
    with pytest.raises(gp.InvalidInput, match="extent 'map' cannot be fused"):
        terrain_map.update(fused, at(), ZERO)
    with pytest.raises(gp.InvalidInput, match="0.015 m, the map's 0.005 m"):
        terrain_map.update(make_scan(0.0, step=1).coarser(3), at(), ZERO)
    with pytest.raises(gp.InvalidInput, match="lost_cells of the metadata"):
        terrain_map.update(make_scan(0.0, step=1, metadata={"lost_cells": [[1, 2]]}), at(), ZERO)


@pytest.mark.parametrize(
    ("outline", "height", "sigma"),
    [
        ([[0, 0], [1, 0]], 0.0, 0.0),
        ([[0, 0], [1, 0], [1, np.nan]], 0.0, 0.0),
        (np.eye(3), np.inf, 0.0),
        (np.eye(3), 0, 0),
    ],
)
def test_known_ground_that_is_none_is_refused(outline: Any, height: float, sigma: float) -> None:
    """Two corners, NaN, three columns, infinite height: refused."""
    with pytest.raises(gp.InvalidInput, match="known ground"):
        gp.KnownGround(outline, height, sigma)
    with pytest.raises(gp.InvalidInput, match="sigma 0 or more"):
        gp.KnownGround(np.array([[0, 0], [1, 0], [1, 1]]), 0.0, -1.0)


def test_ground_declared_far_and_wide_costs_no_more_than_the_map(robot: RobotModel, make_scan: MakeScan) -> None:
    """A square kilometre: the map takes what lies in its window, with the memory of that."""
    terrain_map = gp.TerrainMap(robot)
    whole = gp.KnownGround([(-500.0, -500.0), (500.0, -500.0), (500.0, 500.0), (-500.0, 500.0)], 0.0, 0.002)
    tracemalloc.start()
    fused = terrain_map.update(make_scan(flags=4), at(), ZERO, known_ground=[whole])
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert np.isfinite(fused.elevation).all() and peak < 300e6


def test_cells_seen_by_another_clock_are_stale(robot: RobotModel, make_scan: MakeScan, tmp_path: Path) -> None:
    """A map that was filled by the wall clock, loaded and looked at by one that began at boot: of unknown age."""
    terrain_map = gp.TerrainMap(robot)
    terrain_map.update(make_scan(0.0, stamp=10_000 * 10**9), at(), ZERO)
    terrain_map.save(tmp_path / "map.npz")
    loaded = gp.TerrainMap.load(tmp_path / "map.npz", robot)
    later = loaded.update(make_scan(0.0, step=1, stamp=10_001 * 10**9), at(0.3), ZERO, time=50.0)
    old = np.isfinite(later.elevation) & (later.age > 0)
    assert old.any() and ((later.hazard[old] & Hazard.STALE) != 0).all()


@pytest.mark.slow
def test_declared_ground_in_the_metadata_does_not_grow_without_end(robot: RobotModel, make_scan: MakeScan) -> None:
    """Declared at each pause: of those that filled nothing only the newest is named, none past its validity."""
    terrain_map, pauses = gp.TerrainMap(robot), 2 * Settings.of(robot).validity_pauses
    patch = gp.KnownGround(np.array([(-0.2, -0.1), (0.2, -0.1), (0.2, 0.1), (-0.2, 0.1)]), 0.0, 0.005)
    counts, steps = [], []
    for step in range(pauses):
        fused = terrain_map.update(make_scan(0.0, step=step), at(0.01 * step), drift(1e-6 * step), known_ground=[patch])
        named = fused.metadata["known_ground"]
        counts.append(len(named))
        steps.append(min(entry["step"] for entry in named))
        assert all(entry["cells"] for entry in named[:-1]) and named[-1]["step"] == step
    assert max(counts) <= Settings.of(robot).validity_pauses + 1
    assert steps[-1] >= pauses - 1 - Settings.of(robot).validity_pauses
