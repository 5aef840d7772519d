"""Convex steppable regions: every point passes check_foothold; convex, on a plane, stable."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import guara_perception as gp
from guara_perception.app.messages import message_to_terrain, terrain_to_message
from guara_perception.terrain.layers.record import ScanRecord
from guara_perception.terrain.questions.convex import grow_polygon
from guara_perception.terrain.scan.assess_terrain import default_limits
from kinematics import RobotModel, Stance
from tests.thorough import examples
from transport import decode_terrain
from transport.messages.terrain_message import encode_compact

PROPERTY = settings(max_examples=examples(40), deadline=None, derandomize=True)


def ground(seed: int) -> gp.TerrainGrid:
    """0.7 x 0.7 m with boxes, a ramp and unknown cells."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:140, :140] * 0.005
    heights = rng.uniform(-0.1, 0.1) * x + rng.normal(0, 2e-4, x.shape)
    for _ in range(3):
        iy, ix = rng.integers(0, 120, 2)
        heights[iy : iy + rng.integers(4, 30), ix : ix + rng.integers(4, 30)] += rng.choice([0.012, 0.03, -0.03])
    heights[rng.random(heights.shape) < 0.0005] = np.nan
    return gp.assess_terrain(heights, 0.005, origin=(0.2, -0.35), variance=np.full(heights.shape, 1e-7))


def sent_compactly(terrain: gp.TerrainGrid) -> gp.TerrainGrid:
    """Grid received in the compact encoding."""
    return message_to_terrain(decode_terrain(encode_compact(terrain_to_message(terrain, robot="guara", sequence=1))))


def inner_points(region: gp.SteppableRegion, count: int, seed: int = 0) -> np.ndarray:
    """Random points of a region, including its corners."""
    corners = region.vertices[:, :2]
    share = np.random.default_rng(seed).dirichlet(np.full(len(corners), 0.5), count)
    return np.concatenate((corners, share @ corners))


@pytest.mark.slow
@PROPERTY
@given(st.integers(0, 500), st.floats(0.2, 0.9), st.floats(-0.35, 0.35), st.floats(0.01, 0.3))
def test_every_point_inside_passes_check_foothold(seed: int, x: float, y: float, radius: float) -> None:
    """Corners and random points; None only if no safe cell is within the radius along x and y."""
    terrain = ground(seed)
    region = terrain.steppable_region(x, y, radius)
    cx, cy = terrain.geometry.centres()
    near = (np.abs(cx - x) < radius) & (np.abs(cy[:, None] - y) < radius)
    assert (region is None) == (not ((terrain.traversability > 0) & near).any())
    if region is None:
        return
    points = inner_points(region, 200)
    assert terrain.check_foothold(points[:, 0], points[:, 1]).ok.all()
    assert (np.abs(points - (x, y)) <= radius + 1e-9).all()
    assert (points @ region.halfspaces[:, :2].T <= region.halfspaces[:, 2] + 1e-9).all()
    np.testing.assert_allclose(np.linalg.norm(region.halfspaces[:, :2], axis=1), 1.0)
    assert region.contains(*region.centre)
    heights = terrain.height_at(points[:, 0], points[:, 1])
    on_plane = points @ region.plane[:2] + region.plane[2]
    # A cell's height is that of its centre; on the steepest safe ground, half a cell changes it by a millimetre.
    assert np.abs(heights - on_plane).max() < 0.006 + 0.002


@pytest.mark.slow
@settings(PROPERTY, max_examples=examples(20))
@given(st.integers(0, 500))
def test_regions_of_a_whole_grid(seed: int) -> None:
    """Each region is safe, convex and counter-clockwise; together they cover nearly all safe ground."""
    terrain = ground(seed)
    regions = terrain.steppable_regions()
    safe = terrain.traversability > 0
    x, y = np.meshgrid(*terrain.geometry.centres())
    covered = np.zeros(safe.shape, dtype=bool)
    for region in regions:
        points = inner_points(region, 50)
        assert terrain.check_foothold(points[:, 0], points[:, 1]).ok.all()
        sides = np.roll(region.vertices[:, :2], -1, axis=0) - region.vertices[:, :2]
        after = np.roll(sides, -1, axis=0)
        assert (sides[:, 0] * after[:, 1] - sides[:, 1] * after[:, 0] > -1e-12).all()
        covered |= (np.stack((x, y), -1) @ region.halfspaces[:, :2].T <= region.halfspaces[:, 2] + 1e-9).all(-1)
    assert not (covered & ~safe).any()
    if safe.sum() > 500:
        assert (covered & safe).sum() > 0.75 * safe.sum()


def test_no_region_is_left_out() -> None:
    """Each of 144 islands of safe ground, separated by unknown lines, has its region."""
    heights = np.zeros((12 * 20, 12 * 20))
    heights[::20], heights[:, ::20] = np.nan, np.nan
    small = dataclasses.replace(default_limits(), sole_length=0.02, sole_width=0.02, disc_radius=0.01)
    terrain = gp.assess_terrain(heights, 0.005, limits=small)
    centres = {tuple(np.floor(region.centre / 0.1).astype(int).tolist()) for region in terrain.steppable_regions()}
    assert len(centres) == 144


@pytest.mark.slow
@settings(PROPERTY, max_examples=examples(500))
@given(st.integers(0, 100_000))
def test_any_grid_has_its_regions(seed: int) -> None:
    """Grids of any shape, cell size, noise and slope, original and from the compact encoding: no errors."""
    rng = np.random.default_rng(seed)
    shape, resolution = tuple(rng.integers(1, 150, 2).tolist()), float(rng.choice([0.002, 0.005, 0.01, 0.02]))
    heights = rng.normal(0, 10 ** rng.uniform(-5, -1.5), shape) + rng.normal(0, 0.2) * np.arange(shape[1]) * resolution
    for _ in range(rng.integers(0, 5)):
        iy, ix = (int(rng.integers(0, n)) for n in shape)
        heights[iy : iy + rng.integers(1, 30), ix : ix + rng.integers(1, 30)] += rng.choice([0.012, -0.03, np.nan])
    heights[rng.random(shape) < rng.choice([0, 0.0005, 0.01])] = np.nan
    origin, variance = tuple(rng.uniform(-1, 1, 2).tolist()), np.full(shape, 10 ** rng.uniform(-8, -5))
    terrain = gp.assess_terrain(heights, resolution, origin=origin, variance=variance)
    for grid in (terrain, sent_compactly(terrain)):
        for region in grid.steppable_regions():
            assert grid.check_foothold(*region.centre).ok


@pytest.mark.parametrize("resolution", [0.004, 0.005, 0.02])
@pytest.mark.parametrize("sole", [(0.08, 0.06), (0.044, 0.044), (0.05, 0.03)])
def test_a_sole_off_the_middle_of_a_cell_stays_off_hazards(resolution: float, sole: tuple[float, float]) -> None:
    """A sole whose half is no whole number of cells reaches one cell more where it is off the middle of its cell."""
    limits = dataclasses.replace(default_limits(), sole_length=sole[0], sole_width=sole[1])
    rng = np.random.default_rng(0)
    heights = np.zeros((90, 90))
    for iy, ix in rng.integers(0, 84, (12, 2)):
        heights[iy : iy + 3, ix : ix + 3] = 0.05
    terrain = gp.assess_terrain(heights, resolution, limits=limits)
    regions = [
        terrain.steppable_region(x, 0.3 * 90 * resolution, 0.4) for x in np.linspace(0.1, 0.9, 9) * 90 * resolution
    ]
    regions += terrain.steppable_regions()
    assert any(regions)
    for region in filter(None, regions):
        assert terrain.check_foothold(*inner_points(region, 200).T).ok.all()


def test_on_free_ground_it_is_the_square_that_was_asked_for() -> None:
    """Four sides, the whole area, with plane and sigma of the ground."""
    y, x = np.mgrid[:140, :140] * 0.005 + 0.0025
    terrain = gp.assess_terrain(0.05 * x - 0.02 * y + 0.1, 0.005, variance=np.full(x.shape, 0.001**2))
    region = terrain.steppable_region(0.35, 0.35, 0.1)
    assert region is not None
    assert region.area == pytest.approx(0.04, rel=1e-3)
    assert region.halfspaces.shape == (4, 3)
    assert region.vertices.shape == (4, 3)
    np.testing.assert_allclose(region.plane, [0.05, -0.02, 0.1], atol=1e-6)
    assert region.sigma == pytest.approx(0.001, rel=1e-3)


def test_a_choice_is_kept_until_another_is_a_third_larger() -> None:
    """Two areas beside a trench: the previous choice is kept while the other is only slightly larger."""
    heights = np.zeros((140, 140))
    heights[:, 68:70] = np.nan
    terrain = gp.assess_terrain(heights, 0.005)
    left = terrain.steppable_region(0.25, 0.35, 0.2)
    assert left is not None
    right = terrain.steppable_region(0.43, 0.35, 0.2)
    assert right is not None
    assert right.centre[0] > 0.4 > left.centre[0]
    kept = terrain.steppable_region(0.37, 0.35, 0.2, previous=left)
    assert kept is not None
    free = terrain.steppable_region(0.42, 0.35, 0.2)
    assert free is not None
    assert free.centre[0] > 0.4
    assert terrain.steppable_region(0.42, 0.35, 0.2, previous=right).centre[0] > 0.4


def test_reach_of_a_leg_bounds_it(robot: RobotModel) -> None:
    """With a leg, every point is within its reach; None if it reaches no point."""
    terrain = gp.assess_terrain(np.zeros((140, 320)), 0.005, origin=(-0.6, -0.35))
    stance = Stance(robot.posture("scan"), robot.legs, (0, 0, -1))
    to_footprint = robot.stance_pose(stance).transform_base_to_footprint.tolist()
    metadata = {**terrain.metadata, "robot": robot.name, "stance": stance.to_dict()}
    terrain = dataclasses.replace(
        terrain, record=ScanRecord.from_json({**metadata, "transform_base_to_footprint": to_footprint})
    )
    region = terrain.steppable_region(0.40, 0.18, 0.3, leg="lf", robot=robot)
    assert region is not None
    points = inner_points(region, 500)
    assert terrain.check_foothold(points[:, 0], points[:, 1], leg="lf", robot=robot).ok.all()
    assert region.area < terrain.steppable_region(0.40, 0.18, 0.3).area
    assert terrain.steppable_region(0.8, 0.18, 0.05, leg="lf", robot=robot) is None


@pytest.mark.slow
@settings(max_examples=examples(60), deadline=None, derandomize=True)
@given(st.integers(0, 10_000), st.integers(0, 80))
def test_a_grown_polygon_enters_no_square(seed: int, count: int) -> None:
    """Random squares around the seed: the seed is inside, and no square is touched."""
    rng = np.random.default_rng(seed)
    squares = rng.uniform(-1, 1, (count, 2))
    squares = squares[np.abs(squares).max(axis=1) > 0.06]
    bounds = np.array([[1, 0, 1], [-1, 0, 1], [0, 1, 1], [0, -1, 1.0]])
    polygon = grow_polygon(np.zeros(2), bounds, squares, 0.05)
    a, b = polygon.halfspaces[:, :2], polygon.halfspaces[:, 2]
    assert (b > 0).all()
    for square in squares:
        # Two convex shapes are separate if the other shape is beyond an edge of one of them.
        corners = square + 0.05 * np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]])
        beyond_the_square = np.concatenate((polygon.vertices - square - 0.05, square - 0.05 - polygon.vertices), axis=1)
        assert ((a @ corners.T).min(axis=1) > b - 1e-9).any() or (beyond_the_square > -1e-9).all(axis=0).any()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((np.nan, 0.0, 0.1), "the nominal position is .nan, 0.0.; it must be finite"),
        ((0.0, 0.0, 0.0), "radius is 0.0; it must be above 0"),
        ((None, 0.0, 0.1), "x, y and radius are None, 0.0, 0.1; three numbers are needed"),
        ((0.0, 0.0, 0.1, None, "that one"), "previous is str; it must be a SteppableRegion"),
    ],
)
def test_bad_questions_are_refused(arguments: tuple[object, ...], message: str) -> None:
    """Positions must be finite, and the previous choice a region."""
    with pytest.raises(gp.InvalidInput, match=message):
        ground(0).steppable_region(*arguments)  # type: ignore[arg-type]


def test_a_leg_over_unknown_ground_has_no_region(paper_terrain: gp.TerrainGrid, robot: RobotModel) -> None:
    """No cell is free, so no position of the leg is tested."""
    nothing = gp.assess_terrain(np.full((30, 40), np.nan), 0.005, origin=(0.2, -0.1))
    nothing = dataclasses.replace(nothing, record=paper_terrain.record)
    assert nothing.steppable_regions("lf", robot) == []
    assert nothing.steppable_region(0.3, 0.0, 0.1, "lf", robot=robot) is None
