"""Corrections of a walk compared with accumulated odometry: noise passes, moving ground does not."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import guara_perception as gp
from guara_perception.fields import Fields
from guara_perception.terrain.map.odometry_sum import (
    EARLIER_PAUSES,
    MOST_SIGMAS,
    OdometrySum,
    moved,
    shown_slip,
    transition_between,
)
from kinematics import PoseInOdom, RobotModel
from tests.thorough import examples

MakeScan = Callable[..., gp.TerrainGrid]
SINCE_LAST = np.diag([0.002**2, 0.002**2, 0.001**2, 1e-8, 1e-8, 0.002**2])
SIGMAS = np.array([0.001, 0.001, 0.002])
START = np.diag([1e-10, 1e-10, 1e-10])
NOISE = START


def walked(
    rng: np.random.Generator, corrections: np.ndarray, *, seen: np.ndarray | None = None, step: float = 0.035
) -> tuple[OdometrySum, np.ndarray, np.ndarray]:
    """Sums of a walk with a correction (x, y, yaw) at each pause; last correction and pose of odometry.

    `seen` (n, 3) is the motion of scans minus odometry, with a fifth of its sigma; None: no such motion.
    """
    transform, odometry, sums = np.eye(4), np.eye(4), OdometrySum()
    odometry[:2, 3] = rng.uniform(-5, 5, 2)
    sums = sums.started(transform, odometry, START, NOISE)
    for row, correction in enumerate(corrections):
        before = transform @ odometry
        odometry = odometry.copy()
        odometry[0, 3] += step
        here = transform @ odometry
        found = (np.zeros(3), np.eye(3)) if seen is None else (seen[row], np.diag((SIGMAS / 5) ** 2))
        sums = sums.grown(transition_between(before, here), np.diag(SIGMAS**2), *found)
        transform = moved(correction, here) @ transform
        sums = sums.started(transform, odometry, START, NOISE)
    return sums, transform, odometry


@settings(max_examples=examples(50), deadline=None)
@given(st.integers(0, 10_000))
def test_errors_add_up_as_covariances_do(seed: int) -> None:
    """Corrections of two pauses add up, and a rotation also displaces the robot by its path since."""
    rng = np.random.default_rng(seed)
    first, second = rng.normal(0, 1, (2, 3)) * SIGMAS
    before, here = np.eye(4), np.eye(4)
    before[:2, 3], here[:2, 3] = rng.uniform(-3, 3, (2, 2))
    both = moved(transition_between(before, here) @ first + second, here)
    one_by_one = moved(second, here) @ moved(first, before)
    # Rotations by milliradians: second-order effects over the path.
    np.testing.assert_allclose(both @ here, one_by_one @ here, atol=2e-4)


@settings(max_examples=examples(100), deadline=None)
@given(st.integers(0, 10_000), st.integers(0, 2), st.integers(14, 40))
def test_what_always_goes_one_way_is_found_before_it_adds_up(seed: int, axis: int, pauses: int) -> None:
    """One sigma per pause passes at each pause, but the sum does not, before all of it was accepted."""
    rng = np.random.default_rng(seed)
    corrections = np.zeros((pauses, 3))
    corrections[:, axis] = SIGMAS[axis] * rng.choice([-1, 1])
    sums, transform, odometry = walked(rng, corrections)
    contradiction = sums.contradiction(transform, odometry, NOISE, 0.0)
    if axis == 2:  # A rotation also explains a shift, so less of it adds up.
        assert contradiction is not None or pauses < 24
        return
    assert contradiction is not None
    assert np.abs(contradiction.moved_by[0, axis]) > MOST_SIGMAS * SIGMAS[axis]
    assert contradiction.reason.startswith("registration shifted the walk by ")


@settings(max_examples=examples(100), deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 40))
def test_what_odometry_can_err_by_passes(seed: int, pauses: int) -> None:
    """Corrections well within the accumulated drift of odometry are kept."""
    rng = np.random.default_rng(seed)
    sums, transform, odometry = walked(rng, rng.uniform(-0.2, 0.2, (pauses, 3)) * SIGMAS)
    assert sums.contradiction(transform, odometry, NOISE, 0.0) is None


@settings(max_examples=examples(50), deadline=None)
@given(st.integers(0, 10_000), st.integers(0, 1))
def test_slow_ground_is_found_though_corrections_hardly_follow_it(seed: int, axis: int) -> None:
    """Scans show 1.5 sigma per pause, of which a tenth is corrected: all corrections in memory are undone."""
    rng = np.random.default_rng(seed)
    seen = np.zeros((12, 3))
    seen[:, axis] = 1.5 * SIGMAS[axis] * rng.choice([-1, 1])
    sums, transform, odometry = walked(rng, 0.1 * seen, seen=seen)
    assert sums.suspicion(odometry, NOISE, 0.0) > MOST_SIGMAS
    contradiction = sums.contradiction(transform, odometry, NOISE, 0.0)
    assert contradiction is not None
    assert contradiction.reason.startswith("scans and odometry differ by ")
    np.testing.assert_array_equal(contradiction.transform, np.eye(4))
    assert walked(rng, 0.1 * seen)[0].suspicion(odometry, NOISE, 0.0) == 0.0


@settings(max_examples=examples(50), deadline=None)
@given(st.integers(0, 10_000))
def test_only_what_contradicts_is_taken_back(seed: int) -> None:
    """Ground that moves by 8 sigma in the last pause: corrections more than seven pauses earlier are kept."""
    rng = np.random.default_rng(seed)
    seen = rng.uniform(-0.05, 0.05, (20, 3)) * SIGMAS
    seen[-1, 1] = 8 * SIGMAS[1]
    sums, transform, odometry = walked(rng, rng.uniform(-0.2, 0.2, (20, 3)) * SIGMAS, seen=seen)
    contradiction = sums.contradiction(transform, odometry, NOISE, 0.0)
    assert contradiction is not None
    (kept,) = np.flatnonzero((sums.transforms == contradiction.transform).all(axis=(1, 2)))
    assert 12 <= kept < 20
    # The newest entry is the present pause.
    moved_by = np.linalg.inv(contradiction.transform) @ transform
    assert contradiction.moved_by[0, 2] == pytest.approx(np.arctan2(moved_by[1, 0], moved_by[0, 0]))


@settings(max_examples=examples(50), deadline=None)
@given(st.integers(0, 10_000), st.integers(0, 1))
def test_texture_decides_whether_ground_moved_or_its_relief_alone(seed: int, axis: int) -> None:
    """Heights move: if texture did not, all corrections are kept; corrections that followed are undone."""
    rng = np.random.default_rng(seed)
    seen = np.zeros((12, 3))
    seen[:, axis] = 1.5 * SIGMAS[axis] * rng.choice([-1, 1])
    for share, is_kept in ((0.0, True), (1.0, False)):
        sums, transform, odometry = walked(rng, share * seen, seen=seen)
        contradiction = sums.contradiction(transform, odometry, NOISE, 0.0, textured=True)
        assert contradiction is not None
        assert (contradiction.transform is None) == is_kept


@settings(max_examples=examples(50), deadline=None)
@given(st.floats(-3.1, 3.1), st.floats(0.03, 1.0))
def test_slip_is_believed_along_the_way_more_than_aside(direction: float, length: float) -> None:
    """Slip of 8 % along the path is within two sigma; 14 % across it, as of moving ground, is beyond three."""
    way = length * np.array([np.cos(direction), np.sin(direction)])
    slip, aside = shown_slip(way)[:2, :2], np.array([-way[1], way[0]])
    assert 0.08**2 * way @ np.linalg.solve(slip, way) < 2.0**2
    assert 0.14**2 * aside @ np.linalg.solve(slip, aside) > 3.0**2


@settings(max_examples=examples(50), deadline=None)
@given(st.integers(0, 10_000))
def test_a_slip_along_the_way_passes_as_far_as_robot_toml_grants_it(seed: int) -> None:
    """All feet slide back: robot.toml allows a fraction along the path, and nothing across it."""
    rng = np.random.default_rng(seed)
    along = np.tile([0.003, 0.0, 0.0], (20, 1))
    sums, transform, odometry = walked(rng, along)
    assert sums.contradiction(transform, odometry, NOISE, 0.0) is not None
    assert sums.contradiction(transform, odometry, NOISE, 0.2) is None
    sums, transform, odometry = walked(rng, along[:, [1, 0, 2]])
    assert sums.contradiction(transform, odometry, NOISE, 0.2) is not None


def test_memory_is_bounded_and_a_file_gives_it_back() -> None:
    """An endless walk keeps EARLIER_PAUSES pauses."""
    sums, _, _ = walked(np.random.default_rng(0), np.zeros((EARLIER_PAUSES + 30, 3)))
    assert len(sums.transforms) == len(sums.positions) == len(sums.covariances) == EARLIER_PAUSES
    names = ("transforms", "positions", "covariances", "seen", "seen_covariances", "shown")
    again = OdometrySum.of_fields(Fields({name: getattr(sums, name).tolist() for name in names}, "map.npz"))
    for name in names:
        np.testing.assert_array_equal(getattr(again, name), getattr(sums, name))
    assert not len(OdometrySum.of_fields(Fields({name: [] for name in names}, "map.npz")).transforms)
    # A file of an earlier version has no motions of scans, so the sums start anew.
    earlier = {name: getattr(sums, name).tolist() for name in names[:3]}
    assert not len(OdometrySum.of_fields(Fields(earlier, "map.npz")).transforms)
    assert OdometrySum().contradiction(np.eye(4), np.eye(4), NOISE, 0.04) is None


def bumps(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.asarray(0.012 * np.sin(40 * x) * np.cos(35 * y) + 0.008 * np.sin(23 * x + 31 * y))


def drifting(make_scan: MakeScan, step: int, aside: float) -> gp.TerrainGrid:
    """Scan of bumps that have moved to the right by `aside`, with noise."""
    x, y = np.meshgrid(*make_scan(0.0).geometry.centres())
    noise = np.random.default_rng(step).normal(0, 2e-4, x.shape)
    return make_scan(bumps(x, y + aside) + noise, step=step)


@pytest.mark.slow
def test_ground_that_moves_does_not_take_the_map_along(robot: RobotModel, make_scan: MakeScan, tmp_path: Path) -> None:
    """All ground in view moves 3 mm per pause: corrections are undone and reported, and added to the drift."""
    terrain_map = gp.TerrainMap(robot)
    told, moved_by = None, 0.0
    for step in range(24):
        fused = terrain_map.update(
            drifting(make_scan, step, 0.003 * step),
            PoseInOdom(np.eye(4), step * SINCE_LAST, covariance_since_last=SINCE_LAST),
        )
        record = fused.record
        assert isinstance(record, gp.MapRecord)
        assert record.sideways_correction is not None
        if record.registration_refused:
            told, moved_by = record.registration_refused, 0.003 * step
            break
    assert told is not None and "the ground in view may be moving" in told
    assert record.sideways_correction[1] == pytest.approx(0.0, abs=1e-9)
    seen_at_first = terrain_map.sideways_drift.variances(np.array([1]), np.array([0.7]), np.array([0.0]), np.eye(4))
    assert np.sqrt(seen_at_first[1, 0]) > 0.7 * moved_by
    # The following pauses do not use the ground either, also after a restart.
    terrain_map.save(tmp_path / "map.npz")
    again = gp.TerrainMap.load(tmp_path / "map.npz", robot)
    for each in (terrain_map, again):
        fused = each.update(
            drifting(make_scan, step + 1, 0.003 * (step + 1)),
            PoseInOdom(np.eye(4), 20 * SINCE_LAST, covariance_since_last=SINCE_LAST),
        )
        assert fused.metadata["registration_refused"] == told
        assert fused.metadata["sideways_correction"][1] == pytest.approx(0.0, abs=1e-9)
