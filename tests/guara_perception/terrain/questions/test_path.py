"""Paths and polygons: nothing unknown is crossed, and clearance is measured to the highest ground."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import guara_perception as gp
from guara_perception.terrain.layers.geometry import GridGeometry, distance_to_segment, inside_polygon, touched_cells
from guara_perception.terrain.questions.path import corridor_of, sampled
from kinematics import PoseInOdom, RobotModel
from tests.thorough import examples

MakeScan = Callable[..., gp.TerrainGrid]
PROPERTY = settings(max_examples=examples(60), deadline=None, derandomize=True)
GRID = GridGeometry((-0.1, -0.1), 0.005, (40, 40))
WITHIN = st.floats(-0.0999, 0.0999)
# Spacing of the points of a path that are compared with the cells.
FINE_M = 5e-4


def holed(seed: int) -> gp.TerrainGrid:
    """Flat ground of 0.5 x 0.5 m at z = 0 with random unknown cells."""
    rng = np.random.default_rng(seed)
    heights = np.where(rng.random((100, 100)) < 0.002, np.nan, 0.0)
    return gp.assess_terrain(heights, 0.005)


def swing(x0: float, x1: float, y: float, top: float) -> list[list[float]]:
    """Path up, over and down."""
    return [[x0, y, 0.0], [x0 + 0.02, y, top], [x1 - 0.02, y, top], [x1, y, 0.0]]


coordinate = st.floats(0.02, 0.48)


@pytest.mark.slow
@PROPERTY
@given(st.integers(0, 300), coordinate, coordinate, coordinate, coordinate, st.floats(0.0, 0.03))
def test_a_path_that_comes_near_an_unknown_cell_is_never_accepted(
    seed: int, x0: float, y0: float, x1: float, y1: float, clearance: float
) -> None:
    """Verdict compared with the exact distance of the segment from each unknown square."""
    terrain = holed(seed)
    verdict = terrain.check_path([[x0, y0, 0.2], [x1, y1, 0.2]], clearance)
    iy, ix = np.nonzero(np.isnan(terrain.elevation))
    cx, cy = terrain.geometry.centres()
    along = np.linspace(0, 1, 2000)[:, None]
    px, py = x0 + along * (x1 - x0), y0 + along * (y1 - y0)
    aside = np.hypot(np.maximum(np.abs(px - cx[ix]) - 0.0025, 0), np.maximum(np.abs(py - cy[iy]) - 0.0025, 0))
    nearest = aside.min() if iy.size else np.inf
    margin = min(x0, x1, y0, y1, 0.5 - max(x0, x1), 0.5 - max(y0, y1))
    if nearest < clearance or nearest == 0:
        assert not verdict.ok
        assert "unknown" in {reason.test for reason in verdict.reasons}
    if nearest > clearance + 0.003 and margin > clearance + 0.003:
        assert verdict.ok


@pytest.mark.slow
@PROPERTY
@given(st.integers(0, 300), st.lists(st.tuples(coordinate, coordinate), min_size=3, max_size=6))
def test_a_polygon_that_touches_an_unknown_cell_is_never_accepted(
    seed: int, corners: list[tuple[float, float]]
) -> None:
    """Any polygon, convex or not, with the centre of an unknown cell inside is rejected."""
    terrain = holed(seed)
    verdict = terrain.check_polygon(corners)
    iy, ix = np.nonzero(np.isnan(terrain.elevation))
    cx, cy = terrain.geometry.centres()
    if inside_polygon(np.array(corners), cx[ix], cy[iy]).any():
        assert not verdict.ok
    assert verdict.ok == (not verdict.reasons)


def test_touched_cells_miss_none() -> None:
    """Every cell that contains a random point of a triangle is among the touched cells."""
    rng = np.random.default_rng(0)
    terrain = holed(0)
    corners = np.array([[0.1, 0.1], [0.4, 0.17], [0.2, 0.4]])
    share = rng.dirichlet([1, 1, 1], 5000)
    points = share @ corners
    iy, ix = terrain.geometry.indices(points[:, 0], points[:, 1])
    touched = set(zip(*(a.tolist() for a in touched_cells(corners, terrain.geometry)), strict=True))
    assert set(zip(iy.tolist(), ix.tolist(), strict=True)) <= touched


def test_distance_to_a_segment() -> None:
    """Perpendicular beside it, to the nearer end beyond it, and to the point for a segment of no length."""
    start, stop = np.array([0.0, 0.0]), np.array([2.0, 0.0])
    x, y = np.array([1.0, 3.0, -1.0]), np.array([0.5, 0.0, 1.0])
    np.testing.assert_allclose(distance_to_segment(start, stop, x, y), [0.5, 1.0, np.sqrt(2)])
    np.testing.assert_allclose(distance_to_segment(start, start, x, y), np.hypot(x, y))


def test_clearance_is_measured_over_an_obstacle() -> None:
    """Over a box of 30 mm, a path at 60 mm has 30 mm of clearance; a larger requirement fails with this value."""
    heights = np.zeros((100, 100))
    heights[40:60, 45:55] = 0.03
    terrain = gp.assess_terrain(heights, 0.005)
    assert terrain.check_path(swing(0.15, 0.35, 0.25, 0.06), 0.02)
    over = [[0.1, 0.25, 0.06], [0.4, 0.25, 0.06]]
    passed = terrain.check_path(over, 0.02)
    assert passed
    assert passed.clearance == pytest.approx(0.03, abs=1e-6)
    failed = terrain.check_path(over, 0.035)
    assert not failed
    (reason,) = failed.reasons
    assert reason.test == "clearance"
    assert reason.value == pytest.approx(0.03, abs=1e-6)
    assert reason.limit == 0.035
    assert "at x=0." in reason.detail


def test_uncertain_heights_take_clearance_away() -> None:
    """Two sigmas of 4 mm reduce the clearance by 8 mm."""
    flat = gp.assess_terrain(np.zeros((100, 100)), 0.005, variance=np.full((100, 100), 0.004**2))
    verdict = flat.check_path(swing(0.15, 0.35, 0.25, 0.06), 0.02)
    assert verdict.clearance < 0.06 - 0.008 + 1e-6


@pytest.mark.parametrize("sigma", [0.003, 0.010, 0.045, 0.3])
def test_no_path_is_accepted_because_heights_are_uncertain(sigma: float) -> None:
    """Of 900 swings over and beside random boxes, none that is refused where the same heights are exact."""
    accepted = 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        heights = np.zeros((100, 100))
        for _ in range(4):
            iy, ix = rng.integers(10, 80, 2)
            heights[iy : iy + rng.integers(2, 12), ix : ix + rng.integers(2, 12)] = rng.choice([0.03, 0.06, 0.12])
        exact = gp.assess_terrain(heights, 0.005)
        unsure = gp.assess_terrain(heights, 0.005, variance=np.full(heights.shape, sigma**2))
        for _ in range(15):
            start = rng.uniform(0.1, 0.4, 2)
            end = start + rng.uniform(-0.12, 0.12, 2)
            top, clearance = rng.choice([0.03, 0.06, 0.1, 0.2]), rng.choice([0.01, 0.02, 0.03])
            low, high = (np.array([*at, np.nan_to_num(exact.height_at(*at))]) for at in (start, end))
            path = [low, low + (0, 0, top), high + (0, 0, top), high]
            if unsure.check_path(path, clearance).ok:
                accepted += 1
                assert exact.check_path(path, clearance).ok, (seed, path)
    assert accepted > 100


def test_beside_a_wall_the_distance_counts_sideways() -> None:
    """A path 20 mm beside a higher box has a clearance of 20 mm."""
    heights = np.zeros((100, 100))
    heights[60:80, :] = 0.10
    terrain = gp.assess_terrain(heights, 0.005)
    level = [[0.1, 0.28, 0.05], [0.4, 0.28, 0.05]]
    verdict = terrain.check_path(level, 0.019)
    assert verdict.ok
    assert verdict.clearance == pytest.approx(0.02, abs=1e-6)
    assert not terrain.check_path(level, 0.025).ok


def test_the_ends_may_touch_the_ground_but_not_dive_into_it() -> None:
    """A swing begins and ends at z = 0; an end 20 mm below the ground is rejected for its depth."""
    flat = gp.assess_terrain(np.zeros((100, 100)), 0.005)
    assert flat.check_path(swing(0.15, 0.35, 0.25, 0.06), 0.02).ok
    deep = swing(0.15, 0.35, 0.25, 0.06)
    deep[-1][2] = -0.02
    assert "depth" in {reason.test for reason in flat.check_path(deep, 0.02).reasons}
    through = [[0.1, 0.25, 0.0], [0.25, 0.25, -0.05], [0.4, 0.25, 0.0]]
    assert "clearance" in {reason.test for reason in flat.check_path(through, 0.01).reasons}


def noisy(seed: int, sigma: float) -> gp.TerrainGrid:
    """Flat ground with measurement errors of a known sigma; highest samples are above the mean."""
    rng = np.random.default_rng(seed)
    heights = rng.normal(0, sigma, (100, 100))
    terrain = gp.assess_terrain(heights, 0.005, variance=np.full(heights.shape, sigma**2))
    layers = dict(terrain.layers) | {
        "elevation_max": (heights + np.abs(rng.normal(0, sigma, heights.shape))).astype("f4")
    }
    return dataclasses.replace(terrain, layers=layers)


@pytest.mark.parametrize("clearance", [0.010, 0.020, 0.030])
@pytest.mark.parametrize("seed", range(4))
def test_an_ordinary_swing_over_measured_ground_is_accepted(seed: int, clearance: float) -> None:
    """60 mm up, 140 mm forward and down to the ground, on flat ground with a sigma of 1.5 mm."""
    terrain = noisy(seed, 0.0015)
    up_over_down = [[0.15, 0.25, 0.0], [0.15, 0.25, 0.06], [0.29, 0.25, 0.06], [0.29, 0.25, 0.0]]
    verdict = terrain.check_path(up_over_down, clearance)
    assert verdict.ok, [str(reason) for reason in verdict.reasons]
    assert verdict.clearance >= clearance - 0.012


def test_the_clearance_grows_along_the_way_from_the_ends() -> None:
    """A lift at 45 degrees is accepted, one that stays low for 40 mm is not, at either end."""
    flat = gp.assess_terrain(np.zeros((100, 100)), 0.005)
    creeping = [[0.15, 0.25, 0.0], [0.19, 0.25, 0.004], [0.19, 0.25, 0.06], [0.30, 0.25, 0.06], [0.30, 0.25, 0.0]]
    for path in (creeping, creeping[::-1]):
        (reason,) = flat.check_path(path, 0.02).reasons
        assert reason.test == "clearance"
        assert reason.value < 0.005
        assert reason.limit <= 0.02
    steep = [[0.15, 0.25, 0.0], [0.16, 0.25, 0.06], [0.29, 0.25, 0.06], [0.30, 0.25, 0.0]]
    assert flat.check_path(steep, 0.02).ok


@pytest.mark.slow
@PROPERTY
@given(st.integers(0, 200), coordinate, coordinate, coordinate, st.floats(0.0, 0.08), st.floats(0.002, 0.03))
def test_accepted_paths_keep_their_distance_by_brute_force(
    seed: int, x0: float, x1: float, y: float, top: float, clearance: float
) -> None:
    """Beyond clearance + 5 mm + confidence from the ends, no cell's top is nearer than the clearance."""
    rng = np.random.default_rng(seed)
    heights = np.zeros((100, 100))
    for _ in range(3):
        iy, ix = rng.integers(0, 90, 2)
        heights[iy : iy + 8, ix : ix + 8] = rng.choice([0.01, 0.03])
    terrain = gp.assess_terrain(heights, 0.005, variance=np.full(heights.shape, 0.001**2))
    ends = float(terrain.height_at(x0, y)), float(terrain.height_at(x1, y))
    path = np.array([[x0, y, ends[0]], [x0, y, top], [x1, y, top], [x1, y, ends[1]]])
    if not terrain.check_path(path, clearance).ok:
        return
    dense = np.concatenate([a + np.linspace(0, 1, 60)[:, None] * (b - a) for a, b in zip(path, path[1:], strict=False)])
    away = np.minimum(*(np.linalg.norm(dense - end, axis=1) for end in (path[0], path[-1])))
    dense = dense[away > clearance + 0.005 + 0.002]
    cx, cy = terrain.geometry.centres()
    ix, iy = (a.ravel() for a in np.meshgrid(np.arange(cx.size), np.arange(cy.size)))
    # No other cell is near enough to matter.
    near = (np.abs(cy[iy] - y) < clearance + 0.01) & (cx[ix] > min(x0, x1) - 0.05) & (cx[ix] < max(x0, x1) + 0.05)
    ix, iy = ix[near], iy[near]
    aside = np.hypot(
        np.maximum(np.abs(cx[ix] - dense[:, :1]) - 0.0025, 0), np.maximum(np.abs(cy[iy] - dense[:, 1:2]) - 0.0025, 0)
    )
    distance = np.hypot(aside, np.maximum(dense[:, 2:] - heights[iy, ix] - 0.002, 0))
    # Samples are half a cell apart, so between two of them the path may be a quarter of a cell nearer.
    assert distance.size == 0 or distance.min() >= clearance - 0.00125 - 1e-9


def test_where_looks_disagree_the_highest_counts(robot: RobotModel, make_scan: MakeScan) -> None:
    """A cell observed at 0 and then at 40 mm is CONFLICT; a swing must clear 40 mm, as one at 70 mm does."""
    terrain_map = gp.TerrainMap(robot)
    heights = np.zeros((108, 90))
    terrain_map.update(make_scan(heights, step=0), PoseInOdom(np.eye(4), np.zeros((6, 6))))
    heights[50:58, 40:48] = 0.04
    fused = terrain_map.update(make_scan(heights, step=1), PoseInOdom(np.eye(4), np.zeros((6, 6))))
    x, y = 0.72, 0.0
    assert fused.hazard_at(x, y) & gp.Hazard.CONFLICT
    low, high = ([[0.6, y, z], [0.85, y, z]] for z in (0.05, 0.07))
    assert {reason.test for reason in fused.check_path(low, 0.02).reasons} == {"clearance"}
    assert fused.check_path(high, 0.02).ok


def test_stale_ground_is_not_swung_over() -> None:
    """A height that is too old gives no bound of the present ground."""
    terrain = gp.assess_terrain(np.zeros((100, 100)), 0.005)
    layers = {name: np.array(layer) for name, layer in terrain.layers.items()}
    layers["hazard"][50, 50] |= np.uint16(gp.Hazard.STALE)
    layers["traversability"][50, 50] = 0
    old = dataclasses.replace(terrain, layers=layers)
    (reason,) = old.check_path([[0.1, 0.2525, 0.2], [0.4, 0.2525, 0.2]], 0.0).reasons
    assert reason.test == "hazard"
    assert "STALE" in reason.detail


def test_a_track_on_the_ground_needs_safe_cells() -> None:
    """Points without z: a track along flat ground is accepted, one over an edge is not."""
    heights = np.zeros((100, 100))
    heights[:, 60:] = 0.05
    terrain = gp.assess_terrain(heights, 0.005)
    assert terrain.check_path([[0.05, 0.2], [0.2, 0.3]], 0.02).ok
    failed = terrain.check_path([[0.05, 0.2], [0.4, 0.2]], 0.02)
    assert not failed
    assert failed.reasons[0].test == "hazard"
    assert "STEP" in failed.reasons[0].detail
    assert terrain.check_polygon([[0.05, 0.1], [0.2, 0.1], [0.2, 0.3]]).ok
    assert not terrain.check_polygon([[0.05, 0.1], [0.4, 0.1], [0.2, 0.3]]).ok


def test_off_the_grid_is_unknown() -> None:
    """A path or polygon that leaves the grid is rejected at any height."""
    flat = gp.assess_terrain(np.zeros((100, 100)), 0.005)
    for verdict in (
        flat.check_path([[0.25, 0.25, 1.0], [0.25, 0.6, 1.0]], 0.0),
        flat.check_path([[9.0, 9.0, 1.0]], 0.01),
        flat.check_polygon([[0.4, 0.4], [0.6, 0.4], [0.6, 0.6]]),
    ):
        assert not verdict.ok
        assert "off the grid" in verdict.reasons[0].detail
    assert "unknown 2601 cells" in str(flat.check_polygon([[2.0, 0.0], [2.245, 0.0], [2.245, 0.245], [2.0, 0.245]]))


@pytest.mark.parametrize(
    ("points", "clearance", "message"),
    [
        ([[0.0, 0.0, np.nan]], 0.01, "contain NaN or infinity; allowed: finite points"),
        ([0.0, 0.0, 0.0], 0.01, r"shape \(3,\)"),
        ([[0.0]], 0.01, r"shape \(1, 1\)"),
        (np.empty((0, 3)), 0.01, r"shape \(0, 3\)"),
        ("over there", 0.01, "points of a path: an array of numbers"),
        ([[0, 0, 0], [1000, 0, 0]], 0.01, "allowed: 20 m"),
        ([[0, 0, 0]], -0.01, "clearance is -0.01; it must be 0 ... 1 m"),
        ([[0, 0, 0]], np.nan, "clearance is nan"),
        ([[0, 0, 0]], "0.01", "clearance is '0.01'"),
        ([[0, 0, 0]], None, "clearance is None"),
    ],
)
def test_bad_paths_are_refused(points: object, clearance: float, message: str) -> None:
    """Invalid paths are rejected with what is needed."""
    with pytest.raises(gp.InvalidInput, match=message):
        holed(0).check_path(points, clearance)  # type: ignore[arg-type]


def test_bad_polygons_are_refused() -> None:
    """Two corners are no polygon."""
    with pytest.raises(gp.InvalidInput, match="3 or more finite points"):
        holed(0).check_polygon([[0, 0], [1, 1]])


@settings(max_examples=examples(100), derandomize=True)
@given(st.lists(st.tuples(WITHIN, WITHIN, st.floats(0, 0.1)), min_size=1, max_size=4), st.floats(0, 0.04))
def test_the_corridor_is_what_lies_within_the_clearance(points: list[tuple[float, float, float]], clearance: float):
    """Also between samples and beyond the border of the grid: brute force over a five times finer path."""
    path = np.array(points)
    iy, ix = corridor_of(GRID, sampled(path, GRID.resolution / 2), clearance).unique()
    found = set(zip(iy.tolist(), ix.tolist(), strict=True))
    fine = sampled(path, FINE_M)
    rows = np.arange(-10, 50)
    x, y = (GRID.origin[axis] + (rows + 0.5) * GRID.resolution for axis in (0, 1))
    over_x = np.maximum(np.abs(x[:, None] - fine[:, 0]) - GRID.resolution / 2, 0)
    over_y = np.maximum(np.abs(y[:, None] - fine[:, 1]) - GRID.resolution / 2, 0)
    for row, aside_y in zip(rows, over_y, strict=True):
        distance = np.hypot(over_x, aside_y).min(axis=1)
        corridor = np.array([(int(row), int(column)) in found for column in rows])
        assert corridor[distance <= clearance - FINE_M].all()
        assert not corridor[distance > clearance + GRID.resolution / 4 + FINE_M].any()
