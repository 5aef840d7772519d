"""What counts as surface: confirmed by neighbours, cut at its ends, and never more when a stripe is lost."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from guara_perception.ranging.run_ends import (
    END_COLUMNS,
    FADED_OF_LEVEL,
    LEVEL_COLUMNS,
    SHORT_RUN_COLUMNS,
    run_breaks,
    run_ends,
)
from guara_perception.ranging.scan_surface import scan_surface
from guara_perception.ranging.stripe_points import ColumnPoints, StripePoints, stripe_points
from guara_perception.ranging.surface import OPEN_END_M, joined_surface, line_samples, linked_columns
from guara_perception.ranging.surface_raster import SurfaceRaster
from guara_perception.stripes.profile import StripeProfile, StripeStatus
from guara_perception.terrain.geometry import GridGeometry
from guara_perception.terrain.hazard import Hazard
from guara_perception.terrain.raster import PartSamples

COLUMNS = 40
JOIN = 0.008
GRID = GridGeometry((0.0, 0.0), 0.005, (8, 24))
NOTHING = ColumnPoints(np.empty(0, np.int32), np.empty((0, 3)))


def stripe(x: float, z: object = 0.0, strength: object = 100.0, **extra: object) -> StripePoints:
    """A stripe across 40 mm at x with heights z (scalar or per column, NaN = no return)."""
    heights = np.broadcast_to(np.asarray(z, float), (COLUMNS,))
    points = np.column_stack((np.full(COLUMNS, x), 0.0005 + 0.001 * np.arange(COLUMNS), heights))
    points[np.isnan(heights)] = np.nan
    known = np.isfinite(heights)
    return StripePoints(
        points=points,
        variance=np.where(known, 1e-8, np.nan),
        strength=np.where(known, strength, np.nan),
        status=np.where(known, 0, 1).astype(np.uint8),
        out_of_range=extra.get("out_of_range", NOTHING),  # type: ignore[arg-type]
        doubtful=extra.get("doubtful", NOTHING),  # type: ignore[arg-type]
    )


def raster(stripes: dict[int, StripePoints], pattern: range = range(12)) -> SurfaceRaster:
    result = SurfaceRaster(GRID, pattern, JOIN)
    for index, each in stripes.items():
        result.add({index: each})
    return result


def links_of(first: StripePoints, second: StripePoints) -> np.ndarray:
    """Columns in which two stripes are linked."""
    heights, strengths = (first.points[:, 2], second.points[:, 2]), (first.strength, second.strength)
    return linked_columns(heights, strengths, JOIN)


def joined(
    first: StripePoints, second: StripePoints, goes_on: bool, resolution: float
) -> tuple[np.ndarray, np.ndarray]:
    """Samples (n, 3) and variances of the lines between two stripes, after which the surface goes on or does not."""
    yes = np.ones((1, COLUMNS), bool)
    (samples,) = joined_surface(
        np.stack((first.points.T, second.points.T), axis=1),
        np.stack((first.variance, second.variance)),
        (yes, yes, yes & goes_on),
        resolution,
        yes,
        [0],
    )
    kept = np.isfinite(samples.points[2])
    return samples.points.T[kept], samples.variance[kept]


def known_points(samples: PartSamples) -> set[tuple[float, ...]]:
    """Those samples that were not cut."""
    return {tuple(point) for point in samples.points.T if np.isfinite(point[2])}


def test_flat_ground_is_wholly_known() -> None:
    """Stripes 8 mm apart: every cell between the first and the last is known at the right height."""
    ground = raster({k: stripe(0.004 + 0.008 * k, 0.01) for k in range(12)}).raster()
    inner = ground.elevation[:, 1:18]
    np.testing.assert_allclose(inner, 0.01, atol=1e-9)


def test_a_single_stripe_proves_nothing() -> None:
    """Without a neighbour that confirms it no return is used."""
    assert np.isnan(raster({5: stripe(0.05)}).raster().elevation).all()


def test_a_lost_stripe_leaves_a_gap() -> None:
    """Stripes 4 and 6 are no neighbours: nothing between them is bridged."""
    stripes = {k: stripe(0.004 + 0.008 * k) for k in range(12) if k != 5}
    elevation = raster(stripes).raster().elevation
    assert np.isnan(elevation[:, 8]).all()
    assert np.isfinite(elevation[:, 5]).all() and np.isfinite(elevation[:, 12]).all()


@pytest.mark.parametrize(("rise", "linked"), [(0.0079, True), (0.0081, False)])
def test_links_end_at_the_join_height(rise: float, linked: bool) -> None:
    """Less than `join_height` apart is one surface, more is a wall."""
    assert links_of(stripe(0.0), stripe(0.01, rise)).all() == linked


def test_weak_return_must_agree_in_height() -> None:
    """A return far weaker than its neighbour may be cut by an edge: it is joined only at nearly the same height."""
    strong, weak_level, weak_off = stripe(0.0), stripe(0.01, 0.001, 20.0), stripe(0.01, 0.004, 20.0)
    assert links_of(strong, weak_level).all()
    assert not links_of(strong, weak_off).any()
    assert links_of(strong, stripe(0.01, 0.004, 60.0)).all()


def test_open_end_is_cut_and_the_rest_does_not_move() -> None:
    """Where the surface does not go on, the last bit of the line is left out; the other samples do not move."""
    (whole, _), (cut, _) = (joined(stripe(0.0), stripe(0.008), goes_on, 0.0005) for goes_on in (True, False))
    assert cut[:, 0].max() <= 0.008 - OPEN_END_M + 1e-12
    assert {tuple(p) for p in cut} < {tuple(p) for p in whole}


def test_variance_between_two_stripes_is_that_of_the_interpolation() -> None:
    """In the middle a quarter of each: half the variance of either."""
    points, variance = joined(stripe(0.0), stripe(0.008), True, 0.0001)
    middle = np.abs(points[:, 0] - 0.004) < 1e-4
    np.testing.assert_allclose(variance[middle], 0.5e-8, rtol=0.01)


@given(data=st.data())
@settings(max_examples=40, deadline=None, derandomize=True)
def test_losing_stripes_never_adds_a_sample(data: st.DataObject) -> None:
    """Random heights, gaps and strengths: samples without some stripes are a subset of those with all."""
    random = np.random.default_rng(data.draw(st.integers(0, 10_000)))
    stripes = {}
    for k in range(8):
        z = np.cumsum(random.normal(0, 0.002, COLUMNS))
        z[random.random(COLUMNS) < 0.2] = np.nan
        stripes[k] = stripe(0.01 * k, z, random.uniform(10, 100, COLUMNS))
    lost = data.draw(st.frozensets(st.integers(0, 7), min_size=1, max_size=4))
    whole = {key: known_points(part) for key, part in scan_surface(stripes, range(8), JOIN, 0.005)}
    rest = {k: each for k, each in stripes.items() if k not in lost}
    for key, part in scan_surface(rest, range(8), JOIN, 0.005):
        assert known_points(part) <= whole[key], key


def test_raster_does_not_depend_on_the_order_of_the_stripes() -> None:
    """Parts that were settled early equal those made at the end, bit by bit."""
    random = np.random.default_rng(2)
    stripes = {k: stripe(0.01 * k, random.normal(0, 0.001, COLUMNS)) for k in range(10)}
    ordered = raster(stripes)
    shuffled = raster({int(k): stripes[int(k)] for k in random.permutation(10)})
    for name in ("elevation", "variance", "low", "high", "count"):
        np.testing.assert_array_equal(getattr(ordered.raster(), name), getattr(shuffled.raster(), name))
    assert list(shuffled.stripes) == list(range(10))


@given(data=st.data())
@settings(max_examples=40, deadline=None, derandomize=True)
def test_raster_does_not_depend_on_the_grouping_of_the_stripes(data: st.DataObject) -> None:
    """Stripes near and far apart, lost ones, walls, returns to mark: in any order and groups bit by bit the same."""
    random = np.random.default_rng(data.draw(st.integers(0, 10_000)))
    pitch = data.draw(st.sampled_from([0.002, 0.01, 0.04]))
    stripes = {}
    for k in range(data.draw(st.integers(1, 26))):
        if random.random() < 0.15:
            continue
        z = np.cumsum(random.normal(0, 0.002, COLUMNS))
        z[random.random(COLUMNS) < 0.1] = np.nan
        columns = np.flatnonzero(random.random(COLUMNS) < 0.2)
        height = np.where(random.random(columns.size) < 0.5, 0.2, -0.2)
        beyond = ColumnPoints(columns, np.column_stack((pitch * k + 0 * height, 0.001 * columns, height)))
        stripes[k] = stripe(pitch * k, z, random.uniform(10, 100, COLUMNS), out_of_range=beyond, doubtful=beyond)
    single, several = raster(stripes, range(30)), SurfaceRaster(GRID, range(30), JOIN)
    order = data.draw(st.permutations(list(stripes)))
    while order:
        size = data.draw(st.integers(1, 12))
        several.add({index: stripes[index] for index in order[:size]})
        order = order[size:]
    for name in ("elevation", "variance", "low", "high", "count"):
        np.testing.assert_array_equal(getattr(single.raster(), name), getattr(several.raster(), name))
    np.testing.assert_array_equal(single.marks(), several.marks())
    assert list(single.stripes) == list(several.stripes)


def test_return_above_the_gates_makes_its_cell_unknown() -> None:
    """Something above known ground is in the way: the cell is out of range, its neighbours stay."""
    high = ColumnPoints(np.array([10]), np.array([[0.052, 0.0105, 0.2]]))
    stripes = {k: stripe(0.004 + 0.008 * k) for k in range(12)}
    stripes[6] = stripe(0.004 + 0.048, out_of_range=high)
    result = raster(stripes)
    assert np.isnan(result.raster().elevation[2, 10]) and np.isfinite(result.raster().elevation[2, 9])
    assert result.marks()[2, 10] & Hazard.OUT_OF_RANGE


def test_return_below_the_gates_only_names_the_cause() -> None:
    """From under ground that was seen nothing can return: a stray below it takes nothing away."""
    low = ColumnPoints(np.array([10]), np.array([[0.052, 0.0105, -0.3]]))
    stripes = {k: stripe(0.004 + 0.008 * k) for k in range(12)}
    stripes[6] = stripe(0.004 + 0.048, out_of_range=low)
    result = raster(stripes)
    assert np.isfinite(result.raster().elevation[2, 10])
    assert result.marks()[2, 10] == Hazard.OUT_OF_RANGE


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_a_high_return_is_not_forgotten_for_a_low_one_of_its_cell(order: tuple[int, int]) -> None:
    """Of two returns in one cell the one above the gates counts, in whatever order they come."""
    both = np.array([[0.052, 0.0105, 0.2], [0.052, 0.0115, -0.3]])[list(order)]
    stripes = {k: stripe(0.004 + 0.008 * k) for k in range(12)}
    stripes[6] = stripe(0.004 + 0.048, out_of_range=ColumnPoints(np.array([10, 11]), both))
    assert np.isnan(raster(stripes).raster().elevation[2, 10])


def test_a_drop_seen_by_two_stripes_is_marked_in_between() -> None:
    """Between two returns from below the gates the ground is no better: the cells between are marked too."""
    every = np.arange(COLUMNS)
    ends = [
        ColumnPoints(every, np.column_stack((np.full(COLUMNS, x), stripe(0).points[:, 1], np.full(COLUMNS, -0.2))))
        for x in (0.02, 0.05)
    ]
    stripes = {k: stripe(0, np.nan, out_of_range=ends[k]) for k in (0, 1)}
    marks = raster(stripes).marks()
    assert (marks[:, 4:10] == Hazard.OUT_OF_RANGE).all()
    assert len(line_samples((ends[0], NOTHING), 0.005)) == 0


def ends_of(height: np.ndarray, strength: np.ndarray) -> np.ndarray:
    """Columns at ends of runs of one stripe."""
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
    """A shadow edge cuts the stripe column by column: up to where the strength has come up, nothing is used."""
    height = np.zeros(60)
    height[:10] = np.nan
    strength = np.full(60, 100.0)
    strength[10:18] = [5, 8, 12, 20, 30, 40, 52, 58]
    ends = ends_of(height, strength)
    assert ends[10:16].all()
    assert not ends[20:].any()


def test_short_weak_run_is_left_out() -> None:
    """A few weak columns between gaps are what an edge left of a cut stripe; as strong as the rest they stay."""
    height = np.zeros(80)
    height[20:30] = height[38:48] = np.nan
    strength = np.full(80, 100.0)
    strength[30:38] = 30.0
    assert ends_of(height, strength)[30:38].all()
    strength[30:38] = 100.0
    assert not ends_of(height, strength)[32:36].any()


def plainly_faded(run: list[float]) -> int:
    """First columns of a run before two in a row reach 0.6 of the mean of the next twelve: column by column."""
    holds = []
    for place, value in enumerate(run):
        following = run[place + 1 : place + 1 + LEVEL_COLUMNS]
        holds.append(not following or value >= FADED_OF_LEVEL * sum(following) / len(following))
    for place in range(len(run)):
        if holds[place] and (place + 1 == len(run) or holds[place + 1]):
            return place
    return len(run)


@given(data=st.data())
@settings(max_examples=40, deadline=None, derandomize=True)
def test_fades_of_any_length_are_found(data: st.DataObject) -> None:
    """Runs with smooth or speckled strength, of any length: what is left out at each end is what a plain loop finds."""
    random = np.random.default_rng(data.draw(st.integers(0, 10_000)))
    gap = 5
    runs = [random.integers(1, 256, size).astype(float) for size in random.integers(SHORT_RUN_COLUMNS, 300, 3)]
    for run in runs:
        run[:] *= np.linspace(0.0, 1.0, run.size) ** random.choice([0, 1, 4, 9])
    height, strength, expected = [np.full(gap, np.nan)], [np.zeros(gap)], [np.zeros(gap, bool)]
    for run in (np.round(run) for run in runs):
        left, right = plainly_faded(run.tolist()), plainly_faded(run[::-1].tolist())
        place = np.arange(run.size)
        expected += [
            (place < max(left, END_COLUMNS)) | (place >= run.size - max(right, END_COLUMNS)), np.zeros(gap, bool)
        ]  # fmt: skip
        height += [np.zeros(run.size), np.full(gap, np.nan)]
        strength += [run, np.zeros(gap)]
    np.testing.assert_array_equal(ends_of(np.concatenate(height), np.concatenate(strength)), np.concatenate(expected))


@given(seed=st.integers(0, 10_000))
@settings(max_examples=40, deadline=None, derandomize=True)
def test_runs_of_one_stripe_do_not_touch_the_next(seed: int) -> None:
    """Several stripes at once, with gaps, jumps and fades up to the picture's borders: each as if it were alone."""
    random = np.random.default_rng(seed)
    height = np.repeat(random.choice([0.0, 0.003, 0.02, np.nan], (5, 12)), 7, axis=1)
    strength = random.choice([10.0, 40.0, 100.0], (5, 12)).repeat(7, axis=1) * random.uniform(0.5, 1, height.shape)
    height[2], height[3] = 0.0, np.nan
    for ends, *each in zip(run_ends(height, strength), height, strength, strict=True):
        np.testing.assert_array_equal(ends, ends_of(*each))


class Level:
    """A locator whose point of column c and row r lies at (0, c mm, r mm)."""

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
    """Points of one profile by a level locator."""
    return stripe_points([found], Level(), np.zeros((1, 4)), (-0.08, 0.13), **extra)[0]  # type: ignore[arg-type]


def test_points_outside_the_gates_are_set_apart() -> None:
    """Below and above the gates: no terrain, but a return that was seen."""
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

    class Scattered(Level):
        def measure(self, plane: object, rows: np.ndarray, sigma: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            points, sigmas = super().measure(plane, rows, sigma)
            return np.asfortranarray(points), sigmas

    profiles = [profile(np.zeros(60)), profile(np.zeros(60))]
    sheets, gates = np.zeros((2, 4)), (-0.08, 0.13)
    for found in stripe_points(profiles, Scattered(), sheets, gates, lambda p: (p[:, 1] > 0.02) & (p[:, 1] < 0.03)):  # type: ignore[arg-type]
        assert np.isnan(found.points[21:30, 2]).all()
        assert np.isfinite(found.points[:18, 2]).all() and np.isfinite(found.points[34:, 2]).all()


def test_doubtful_returns_keep_their_place() -> None:
    """A return that may not be used says where it was, unless that is outside the gates."""
    doubtful = np.full(60, np.nan, np.float32)
    doubtful[10], doubtful[11] = 5.0, 900.0
    rows = np.where(np.isfinite(doubtful), np.nan, 0.0)
    found = points_of(profile(rows, doubtful))
    assert found.doubtful.points[found.doubtful.columns == 10, 2] == pytest.approx([0.005])
    assert 11 not in found.doubtful.columns


def test_profiles_together_are_the_profiles_alone() -> None:
    """Gaps, returns beyond the gates, doubtful ones and a leg, in one go: each stripe as if it were alone."""
    random = np.random.default_rng(8)
    profiles = []
    for _ in range(5):
        rows = np.repeat(random.choice([0.0, 2.0, -200.0, 300.0, np.nan], 6), 10)
        doubtful = np.where(random.random(60) < 0.1, random.choice([5.0, 900.0, 25.0], 60), np.nan).astype(np.float32)
        profiles.append(profile(np.where(np.isfinite(doubtful), np.nan, rows), doubtful))
    profiles.append(profile(np.zeros(60)))
    extra = {"on_robot": lambda p: (p[:, 1] > 0.02) & (p[:, 2] > 0.02)}
    together = stripe_points(profiles, Level(), np.zeros((6, 4)), (-0.08, 0.13), **extra)
    for found, alone in zip(together, (points_of(each, **extra) for each in profiles), strict=True):
        for name in ("points", "variance", "strength", "status"):
            np.testing.assert_array_equal(getattr(found, name), getattr(alone, name))
            assert not getattr(found, name).flags.writeable
        for name in ("out_of_range", "doubtful"):
            np.testing.assert_array_equal(getattr(found, name).columns, getattr(alone, name).columns)
            np.testing.assert_array_equal(getattr(found, name).points, getattr(alone, name).points)
    assert sum(len(found.doubtful.columns) for found in together) > 0
    assert sum(len(found.out_of_range.columns) for found in together) > 0
