"""Surface of a scan: confirmed by neighbours, shortened at its ends, and never larger when a stripe is lost."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from guara_perception.ranging.stripe_points import ColumnPoints, StripePoints
from guara_perception.ranging.surface import (
    EVERYWHERE,
    OPEN_END_M,
    sample_count,
    samples_of,
    shares,
    surface_keys,
    surface_of,
)
from guara_perception.ranging.surface import links_of as surface_links
from guara_perception.scanning.scan_surface import SurfaceRaster, line_samples
from guara_perception.terrain.assessment.raster import SurfaceSamples
from guara_perception.terrain.layers.geometry import GridGeometry
from guara_perception.terrain.layers.hazard import Hazard
from tests.guara_perception.ranging.plain_run_ends import pair_relief
from tests.thorough import examples

COLUMNS = 40
JOIN = 0.008
GRID = GridGeometry((0.0, 0.0), 0.005, (8, 24))


def column_points(columns: object, points: object) -> ColumnPoints:
    """Points of some columns, as a stripe has them."""
    return ColumnPoints(np.asarray(columns, np.int32), np.asarray(points, np.float32))


NOTHING = column_points([], np.empty((0, 3)))


def stripe(x: float, z: object = 0.0, strength: object = 100.0, **extra: object) -> StripePoints:
    """A stripe across 40 mm at x with heights z (scalar or per column, NaN = no return)."""
    heights = np.broadcast_to(np.asarray(z, float), (COLUMNS,))
    points = np.column_stack((np.full(COLUMNS, x), 0.0005 + 0.001 * np.arange(COLUMNS), heights))
    points[np.isnan(heights)] = np.nan
    known = np.isfinite(heights)
    return StripePoints(
        points=points.astype(np.float32),
        variance=np.where(known, 1e-8, np.nan).astype(np.float32),
        strength=np.where(known, strength, np.nan).astype(np.float32),
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
    return surface_links({0: first, 1: second}, [(0, 1)], range(2), JOIN, EVERYWHERE).links[1][0]


def plain_links(first: StripePoints, second: StripePoints) -> np.ndarray:
    """The same by plain array operations: a return much weaker than the other must agree more closely."""
    weaker, stronger = np.minimum(first.strength, second.strength), np.maximum(first.strength, second.strength)
    allowed = np.where(weaker < np.float32(0.4) * stronger, 0.0015, JOIN)
    return np.abs(first.points[:, 2] - second.points[:, 2]) < allowed


def joined(
    first: StripePoints, second: StripePoints, goes_on: bool, resolution: float
) -> tuple[np.ndarray, np.ndarray]:
    """Samples (n, 3) and variances of the lines between two stripes, after which the surface goes on or does not."""
    stripes, pattern = {0: first, 1: second}, range(2 if goes_on else 3)
    samples = surface_of(stripes, [(0, 1)], pattern, JOIN, resolution)
    kept = np.isfinite(samples.points[2])
    return samples.points.T[kept], samples.variance[kept]


def known_points(samples: SurfaceSamples) -> set[tuple[float, ...]]:
    """Those samples that were not cut."""
    return {tuple(point) for point in samples.points.T if np.isfinite(point[2])}


def test_flat_ground_is_wholly_known() -> None:
    """Stripes 8 mm apart: every cell between the first and the last is known at the right height."""
    ground = raster({k: stripe(0.004 + 0.008 * k, 0.01) for k in range(12)}).raster()
    inner = ground.elevation[:, 1:18]
    np.testing.assert_allclose(inner, 0.01, atol=1e-9)


def test_a_single_stripe_proves_nothing() -> None:
    """Without a neighbour that confirms it, no return is used."""
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
    strong, weak_near, weak_off = stripe(0.0), stripe(0.01, 0.001, 20.0), stripe(0.01, 0.004, 20.0)
    assert links_of(strong, weak_near).all()
    assert not links_of(strong, weak_off).any()
    assert links_of(strong, stripe(0.01, 0.004, 60.0)).all()


def test_open_end_is_cut_and_the_rest_does_not_move() -> None:
    """Where the surface does not go on, the last piece of the line is left out; the other samples do not move."""
    (whole, _), (cut, _) = (joined(stripe(0.0), stripe(0.008), goes_on, 0.0005) for goes_on in (True, False))
    assert cut[:, 0].max() <= 0.008 - OPEN_END_M + 1e-12
    assert {tuple(p) for p in cut} < {tuple(p) for p in whole}


def test_between_two_stripes_nothing_is_surer_than_they_are() -> None:
    """On a plane as sure as the points; on ground as rough along the stripes the relief between them is added."""
    points, variance = joined(stripe(0.0), stripe(0.008), True, 0.0001)
    np.testing.assert_allclose(variance, 1e-8, rtol=1e-6)
    rough = 0.001 * np.sin(2 * np.pi * np.arange(COLUMNS) / 8)
    points, variance = joined(stripe(0.0, rough), stripe(0.008, rough), True, 0.0001)
    # Half a stripe spacing to either side, the heights have the opposite sign: each is off their mean by twice itself.
    is_centre = np.abs(points[:, 0] - 0.004) < 1e-4
    assert np.median(variance[is_centre]) == pytest.approx(4 * np.mean(rough**2), rel=0.05)
    assert variance.min() >= 1e-8


@pytest.mark.parametrize("seed", range(4))
def test_samples_between_stripes_are_those_of_plain_array_operations(seed: int) -> None:
    """Of rough stripes with gaps and walls, unevenly far apart, with pairs that nobody asks for."""
    random = np.random.default_rng(seed)
    stripes = {}
    for k in range(6):
        heights = random.choice([0.0, 0.0, 0.0, 0.02, np.nan], COLUMNS // 5 + 1).repeat(5)[:COLUMNS]
        strength = random.choice([100.0, 30.0], COLUMNS)
        stripes[k] = stripe(0.008 * k + 0.002 * (k == 3), heights + random.normal(0, 1e-3, COLUMNS), strength)
    keys = [key for key in surface_keys(stripes, range(8)) if key != (1, 2)]
    seen = surface_links(stripes, keys, range(8), JOIN, (-math.inf, 0.03))
    variance = np.array([stripes[index].variance for index in seen.indices])
    samples = samples_of(seen, variance, 0.002)
    linked = np.array([plain_links(stripes[k], stripes[k + 1]) for k in range(5)])
    # Before the first stripe of the pattern nothing contradicts the surface; two are missing at its other end.
    before, between, after = (
        np.vstack((np.ones(COLUMNS, bool), linked[:4])),
        linked,
        np.vstack((linked[1:], ~linked[:1] & False)),
    )
    is_wanted = ~(seen.points[1] > 0.03)
    known = np.isfinite(seen.points[2, :-1])
    confirmed = np.flatnonzero(np.vstack((before & between & known & is_wanted[:-1], np.zeros(COLUMNS, bool))))
    expected = [(*seen.points.reshape(3, -1)[:, confirmed], variance.ravel()[confirmed])]
    between[1] = False
    differences = seen.points[:, 1:] - seen.points[:, :-1]
    longest = np.sqrt(np.where(between, differences[0] ** 2 + differences[1] ** 2, 0).max(axis=1))
    for k, number in enumerate(sample_count(longest, 0.002)):
        column = np.flatnonzero(between[k] & (is_wanted[k] | is_wanted[k + 1]))
        relief = pair_relief(seen.points[:, k : k + 2], variance[k : k + 2])[column]
        begin, difference = (each[:, k, column].astype(np.float64) for each in (seen.points, differences))
        for share in shares(number)[:, 0]:
            x, y, z = begin + share * difference
            length = np.minimum(OPEN_END_M / np.maximum(np.hypot(*difference[:2]), 1e-9), 0.5)
            opens, closes = (np.where(link[k, column], 0, length) for link in (before, after))
            z[(share < opens) | (share > 1 - closes)] = np.nan
            own, other = variance[k : k + 2, column]
            expected.append((x, y, z, (1 - share) * own + share * other + 4 * share * (1 - share) * relief))
    found, plain = np.vstack((samples.points, samples.variance)), np.concatenate(expected, axis=1)
    assert found.shape == plain.shape and 0 < np.isnan(found[2]).sum() < found.shape[1] / 2
    in_order = (values[:, np.lexsort(np.nan_to_num(values[[2, 1, 0]]))] for values in (found, plain))
    np.testing.assert_allclose(next(in_order), next(in_order), rtol=1e-6, atol=1e-12)
    asked = {keys.index((k, k)) for k in range(6)} | {keys.index((k, k + 1)) for k in (0, 2, 3, 4)}
    assert {swath for swath, _ in samples.runs} <= asked
    assert sum(length for _, length in samples.runs) == len(samples.variance)


def surfaces(stripes: dict[int, StripePoints]) -> dict[tuple[int, int], set[tuple[float, ...]]]:
    """The known samples of each stripe and each pair by itself."""
    keys = surface_keys(stripes, range(8))
    return {key: known_points(surface_of(stripes, [key], range(8), JOIN, 0.005)) for key in keys}


@pytest.mark.slow
@given(data=st.data())
@settings(max_examples=examples(40), deadline=None, derandomize=True)
def test_losing_stripes_never_adds_a_sample(data: st.DataObject) -> None:
    """Random heights, gaps and strengths: samples without some stripes are a subset of those with all."""
    random = np.random.default_rng(data.draw(st.integers(0, 10_000)))
    stripes = {}
    for k in range(8):
        z = np.cumsum(random.normal(0, 0.002, COLUMNS))
        z[random.random(COLUMNS) < 0.2] = np.nan
        stripes[k] = stripe(0.01 * k, z, random.uniform(10, 100, COLUMNS))
    lost = data.draw(st.frozensets(st.integers(0, 7), min_size=1, max_size=4))
    whole = surfaces(stripes)
    rest = {k: each for k, each in stripes.items() if k not in lost}
    for key, samples in surfaces(rest).items():
        assert samples <= whole[key], key


def test_raster_does_not_depend_on_the_order_of_the_stripes() -> None:
    """Samples that were settled early equal those made at the end, bit for bit."""
    random = np.random.default_rng(2)
    stripes = {k: stripe(0.01 * k, random.normal(0, 0.001, COLUMNS)) for k in range(10)}
    ordered = raster(stripes)
    shuffled = raster({int(k): stripes[int(k)] for k in random.permutation(10)})
    for name in ("elevation", "variance", "low", "high"):
        np.testing.assert_array_equal(getattr(ordered.raster(), name), getattr(shuffled.raster(), name))
    assert list(shuffled.stripes) == list(range(10))


@pytest.mark.slow
@given(data=st.data())
@settings(max_examples=examples(40), deadline=None, derandomize=True)
def test_raster_does_not_depend_on_the_grouping_of_the_stripes(data: st.DataObject) -> None:
    """Stripes near and far apart, lost ones, walls, returns to mark: in any order and groups the same bit for bit."""
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
        beyond = column_points(columns, np.column_stack((pitch * k + 0 * height, 0.001 * columns, height)))
        stripes[k] = stripe(pitch * k, z, random.uniform(10, 100, COLUMNS), out_of_range=beyond, doubtful=beyond)
    single, several = raster(stripes, range(30)), SurfaceRaster(GRID, range(30), JOIN)
    order = data.draw(st.permutations(list(stripes)))
    while order:
        size = data.draw(st.integers(1, 12))
        if data.draw(st.booleans()):
            # Results asked for in between do not change later ones.
            several.raster(), several.marks()
        several.add({index: stripes[index] for index in order[:size]})
        order = order[size:]
    for name in ("elevation", "variance", "low", "high"):
        np.testing.assert_array_equal(getattr(single.raster(), name), getattr(several.raster(), name))
    np.testing.assert_array_equal(single.marks(), several.marks())
    assert list(single.stripes) == list(several.stripes)


def test_return_above_the_height_limits_makes_its_cell_unknown() -> None:
    """Something above known ground is in the way: the cell is out of range, its neighbours stay."""
    high = column_points(np.array([10]), np.array([[0.052, 0.0105, 0.2]]))
    stripes = {k: stripe(0.004 + 0.008 * k) for k in range(12)}
    stripes[6] = stripe(0.004 + 0.048, out_of_range=high)
    result = raster(stripes)
    assert np.isnan(result.raster().elevation[2, 10]) and np.isfinite(result.raster().elevation[2, 9])
    assert result.marks()[2, 10] & Hazard.OUT_OF_RANGE


def test_return_below_the_height_limits_only_names_the_cause() -> None:
    """No light can return from below a measured surface: such a stray return takes nothing away."""
    low = column_points(np.array([10]), np.array([[0.052, 0.0105, -0.3]]))
    stripes = {k: stripe(0.004 + 0.008 * k) for k in range(12)}
    stripes[6] = stripe(0.004 + 0.048, out_of_range=low)
    result = raster(stripes)
    assert np.isfinite(result.raster().elevation[2, 10])
    assert result.marks()[2, 10] == Hazard.OUT_OF_RANGE


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_a_high_return_is_not_forgotten_for_a_low_one_of_its_cell(order: tuple[int, int]) -> None:
    """Of two returns in one cell the one above the height limits counts, in whatever order they come."""
    both = np.array([[0.052, 0.0105, 0.2], [0.052, 0.0115, -0.3]])[list(order)]
    stripes = {k: stripe(0.004 + 0.008 * k) for k in range(12)}
    stripes[6] = stripe(0.004 + 0.048, out_of_range=column_points(np.array([10, 11]), both))
    assert np.isnan(raster(stripes).raster().elevation[2, 10])


def test_a_drop_seen_by_two_stripes_is_marked_in_between() -> None:
    """Ground between two returns below the height limits is out of range too."""
    every = np.arange(COLUMNS)
    ends = [
        column_points(every, np.column_stack((np.full(COLUMNS, x), stripe(0).points[:, 1], np.full(COLUMNS, -0.2))))
        for x in (0.02, 0.05)
    ]
    stripes = {k: stripe(0, np.nan, out_of_range=ends[k]) for k in (0, 1)}
    marks = raster(stripes).marks()
    assert (marks[:, 4:10] == Hazard.OUT_OF_RANGE).all()
    assert len(line_samples((ends[0], NOTHING), 0.005)) == 0
