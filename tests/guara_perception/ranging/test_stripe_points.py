"""Points of profiles: separated by the height limits, dropped on the robot, kept apart if doubtful."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from guara_perception.ranging.stripe_points import StripePoints, stripe_points
from guara_perception.stripes.band import StripeProfile, StripeStatus
from testbed.run_ends import run_ends
from tests.guara_perception.ranging import plain_run_ends
from tests.guara_perception.ranging.plain_run_ends import (
    END_COLUMNS,
    FADED_OF_LEVEL,
    LEVEL_COLUMNS,
    SHORT_RUN_COLUMNS,
    run_breaks,
)
from tests.thorough import examples


class PlainLocator:
    """Locator whose point of column c and row r is (0, c mm, r mm)."""

    view_point = np.zeros(3)

    def points(self, plane: object, rows: np.ndarray, columns: np.ndarray | None = None) -> np.ndarray:
        rows = np.asarray(rows, float)
        columns = np.arange(rows.shape[-1]) if columns is None else columns
        points = np.stack(np.broadcast_arrays(0.0, 0.001 * columns, 0.001 * rows))
        points[:, np.isnan(rows)] = np.nan
        return points

    def measure(self, plane: object, rows: np.ndarray, sigma: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return self.points(plane, rows), 0.001 * np.asarray(sigma, float)


def profile(rows: np.ndarray, doubtful: np.ndarray | None = None) -> StripeProfile:
    rows = np.asarray(rows, np.float32)
    known = np.isfinite(rows)
    status = np.where(known, StripeStatus.OK, StripeStatus.DROPOUT).astype(np.uint8)
    sigma = np.where(known, 0.1, np.nan).astype(np.float32)
    nothing = np.full(rows.size, np.nan, np.float32)
    return StripeProfile(
        rows, sigma, status, np.full(rows.size, 50, np.float32), nothing if doubtful is None else doubtful
    )


def points_of(found: StripeProfile, **extra: object) -> StripePoints:
    """Points of one profile by `PlainLocator`."""
    return stripe_points([found], PlainLocator(), np.zeros((1, 4)), (-0.08, 0.13), **extra)[0]  # type: ignore[arg-type]


def test_points_outside_the_height_limits_are_set_apart() -> None:
    """Below and above the height limits: no terrain, but a return that was seen."""
    rows = np.repeat([0.0, -200.0, 0.0, 300.0, 0.0], 20)
    found = points_of(profile(rows))
    low, high = slice(24, 36), slice(64, 76)
    assert np.isnan(found.points[low]).all() and np.isnan(found.points[high]).all()
    heights = dict(zip(found.out_of_range.columns.tolist(), found.out_of_range.points[:, 2].tolist(), strict=True))
    assert [heights[c] for c in range(24, 36)] == pytest.approx(12 * [-0.2])
    assert [heights[c] for c in range(64, 76)] == pytest.approx(12 * [0.3])
    assert (found.status[low] == StripeStatus.OUT_OF_BAND).all()
    assert (found.status[18:22] == StripeStatus.MIXED_EDGE).sum() >= 2
    np.testing.assert_allclose(found.variance[5:15], 1e-8)


def test_points_on_the_robot_are_dropped() -> None:
    """What lies on a leg is no terrain, and what is beside it ends a run."""
    found = points_of(profile(np.zeros(60)), on_robot=lambda p: (p[:, 1] > 0.02) & (p[:, 1] < 0.03))
    assert np.isnan(found.points[21:30, 2]).all()
    assert not ((found.doubtful.columns > 20) & (found.doubtful.columns < 30)).any()
    assert np.isfinite(found.points[:18, 2]).all() and np.isfinite(found.points[34:, 2]).all()


def test_points_on_the_robot_are_dropped_however_they_lie_in_memory() -> None:
    """A locator may give its coordinates in any layout."""

    class Scattered(PlainLocator):
        def measure(self, plane: object, rows: np.ndarray, sigma: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            points, sigmas = super().measure(plane, rows, sigma)
            return np.asfortranarray(points), sigmas

    profiles = [profile(np.zeros(60)), profile(np.zeros(60))]
    planes, limits = np.zeros((2, 4)), (-0.08, 0.13)
    for found in stripe_points(profiles, Scattered(), planes, limits, lambda p: (p[:, 1] > 0.02) & (p[:, 1] < 0.03)):  # type: ignore[arg-type]
        assert np.isnan(found.points[21:30, 2]).all()
        assert np.isfinite(found.points[:18, 2]).all() and np.isfinite(found.points[34:, 2]).all()


def test_doubtful_returns_keep_their_position() -> None:
    """An unusable return keeps its position, unless this is outside the height limits."""
    doubtful = np.full(60, np.nan, np.float32)
    doubtful[10], doubtful[11] = 5.0, 900.0
    rows = np.where(np.isfinite(doubtful), np.nan, 0.0)
    found = points_of(profile(rows, doubtful))
    assert found.doubtful.points[found.doubtful.columns == 10, 2] == pytest.approx([0.005])
    assert 11 not in found.doubtful.columns


def test_profiles_together_are_the_profiles_alone() -> None:
    """Gaps, returns beyond the height limits, doubtful ones and a leg: together each stripe is as if it were alone."""
    random = np.random.default_rng(8)
    profiles = []
    for _ in range(5):
        rows = np.repeat(random.choice([0.0, 2.0, -200.0, 300.0, np.nan], 6), 10)
        doubtful = np.where(random.random(60) < 0.1, random.choice([5.0, 900.0, 25.0], 60), np.nan).astype(np.float32)
        profiles.append(profile(np.where(np.isfinite(doubtful), np.nan, rows), doubtful))
    profiles.append(profile(np.zeros(60)))
    extra = {"on_robot": lambda p: (p[:, 1] > 0.02) & (p[:, 2] > 0.02)}
    together = stripe_points(profiles, PlainLocator(), np.zeros((6, 4)), (-0.08, 0.13), **extra)
    for found, alone in zip(together, (points_of(each, **extra) for each in profiles), strict=True):
        for name in ("points", "variance", "strength", "status"):
            np.testing.assert_array_equal(getattr(found, name), getattr(alone, name))
            assert not getattr(found, name).flags.writeable
        for name in ("out_of_range", "doubtful"):
            np.testing.assert_array_equal(getattr(found, name).columns, getattr(alone, name).columns)
            np.testing.assert_array_equal(getattr(found, name).points, getattr(alone, name).points)
    assert sum(len(found.doubtful.columns) for found in together) > 0
    assert sum(len(found.out_of_range.columns) for found in together) > 0


def ends_of(height: np.ndarray, strength: np.ndarray) -> np.ndarray:
    """Columns of one stripe that are left out."""
    return run_ends(height[None], strength[None])[0]


def test_ends_of_a_run_are_left_out() -> None:
    """Beside a gap and on both sides of a jump columns are dropped; at the picture's border none is."""
    height = np.zeros(60)
    height[20:30] = np.nan
    height[45:] = 0.02
    ends = ends_of(height, np.full(60, 100.0))
    expected = np.zeros(60, bool)
    for begin in (20 - END_COLUMNS, 30, 45 - END_COLUMNS, 45):
        expected[begin : begin + END_COLUMNS] = True
    np.testing.assert_array_equal(ends, expected)
    assert run_breaks(height[None])[0, 44]


def test_fading_end_of_a_run_is_left_out() -> None:
    """A shadow's edge weakens a stripe column by column: none is used before the strength is 0.6 of what follows."""
    height = np.zeros(60)
    height[:10] = np.nan
    strength = np.full(60, 100.0)
    strength[10:18] = [5, 8, 12, 20, 30, 40, 52, 58]
    ends = ends_of(height, strength)
    assert ends[10:16].all()
    assert not ends[20:].any()


def test_short_weak_run_is_left_out() -> None:
    """A few weak columns between gaps are left out; as strong as the others they are used."""
    height = np.zeros(80)
    height[20:30] = height[38:48] = np.nan
    strength = np.full(80, 100.0)
    strength[30:38] = 30.0
    assert ends_of(height, strength)[30:38].all()
    strength[30:38] = 100.0
    assert not ends_of(height, strength)[32:36].any()


def test_dim_and_displaced_end_of_a_run_is_left_out() -> None:
    """Along a shadow's edge a stripe is cut lengthwise: dim, and too high. Bright bumps, slopes, dim flat ends stay."""
    height, strength = np.zeros((2, 120))
    height[:10] = np.nan
    strength[10:] = 100.0
    height[12:19], strength[12:19] = 0.002, 75.0
    ends = ends_of(height, strength)
    assert ends[10:19].all() and not ends[19:].any()
    np.testing.assert_array_equal(ends_of(height[::-1], strength[::-1]), ends[::-1])
    sound = np.arange(120) == 10
    sound[11] = True
    np.testing.assert_array_equal(ends_of(height, np.where(strength > 0, 100.0, 0.0)), sound)
    np.testing.assert_array_equal(ends_of(np.where(height == 0.002, 0.0, height), strength), sound)
    np.testing.assert_array_equal(ends_of(height * 0 + 0.0005 * np.arange(120), strength), sound)


def plainly_faded(run: list[float]) -> int:
    """Number of columns before two in a row reach 0.6 of the mean of the next twelve, by a plain loop."""
    holds = []
    for index, value in enumerate(run):
        following = run[index + 1 : index + 1 + LEVEL_COLUMNS]
        holds.append(not following or value >= FADED_OF_LEVEL * sum(following) / len(following))
    for index in range(len(run)):
        if holds[index] and (index + 1 == len(run) or holds[index + 1]):
            return index
    return len(run)


@given(data=st.data())
@settings(max_examples=examples(40), deadline=None, derandomize=True)
def test_fades_of_any_length_are_found(data: st.DataObject) -> None:
    """Runs of any length, smooth or speckled: at each end those columns are left out that a plain loop finds."""
    random = np.random.default_rng(data.draw(st.integers(0, 10_000)))
    gap = 5
    runs = [random.integers(1, 256, size).astype(float) for size in random.integers(SHORT_RUN_COLUMNS, 300, 3)]
    for run in runs:
        run[:] *= np.linspace(0.0, 1.0, run.size) ** random.choice([0, 1, 4, 9])
    height, strength, expected = [np.full(gap, np.nan)], [np.zeros(gap)], [np.zeros(gap, bool)]
    for run in (np.round(run) for run in runs):
        left, right = plainly_faded(run.tolist()), plainly_faded(run[::-1].tolist())
        index = np.arange(run.size)
        expected += [
            (index < max(left, END_COLUMNS)) | (index >= run.size - max(right, END_COLUMNS)), np.zeros(gap, bool)
        ]  # fmt: skip
        height += [np.zeros(run.size), np.full(gap, np.nan)]
        strength += [run, np.zeros(gap)]
    np.testing.assert_array_equal(ends_of(np.concatenate(height), np.concatenate(strength)), np.concatenate(expected))


@given(seed=st.integers(0, 10_000))
@settings(max_examples=examples(40), deadline=None, derandomize=True)
def test_runs_of_one_stripe_do_not_touch_the_next(seed: int) -> None:
    """Stripes with gaps, jumps and fades up to the picture's borders: together each gives what it gives alone."""
    random = np.random.default_rng(seed)
    height = np.repeat(random.choice([0.0, 0.003, 0.02, np.nan], (5, 12)), 7, axis=1)
    strength = random.choice([10.0, 40.0, 100.0], (5, 12)).repeat(7, axis=1) * random.uniform(0.5, 1, height.shape)
    height[2], height[3] = 0.0, np.nan
    together = run_ends(height, strength)
    np.testing.assert_array_equal(together, plain_run_ends.run_ends(height, strength))
    for ends, *each in zip(together, height, strength, strict=True):
        np.testing.assert_array_equal(ends, ends_of(*each))
