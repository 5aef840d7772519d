"""Grids from the compact encoding accept nothing that the original grid rejects."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import guara_perception as gp
from guara_perception.app.messages import message_to_terrain, terrain_to_message
from guara_perception.terrain.layers.record import ScanRecord
from kinematics import PoseInOdom, RobotModel
from testbed.truth import truth_calibration
from tests.thorough import examples, further
from transport import decode_terrain
from transport.messages.terrain_message import ROUNDING, encode_compact

PROPERTY = settings(max_examples=examples(10), deadline=None, derandomize=True)
SHARED = Path(__file__).parents[5] / "shared" / "data"
RECORDED = ["paper"]
OTHERS = [
    "dark",
    "tilt",
    "small/paper",
    "small/rough",
    "small/dark",
    "small/glare",
    "small/tilt",
    "small/empty",
    "full/paper",
    "full/dark",
]


def sent_compactly(terrain: gp.TerrainGrid) -> gp.TerrainGrid:
    """Grid received in the compact encoding."""
    message = terrain_to_message(terrain, robot="guara", sequence=1)
    return message_to_terrain(decode_terrain(encode_compact(message)))


@st.composite
def worlds(draw: st.DrawFn) -> gp.TerrainGrid:
    """Grids with boxes, holes, slopes, noise and variances of any size."""
    rng = np.random.default_rng(draw(st.integers(0, 10_000)))
    shape = (44, 60)
    y, x = np.mgrid[: shape[0], : shape[1]] * 0.005
    heights = rng.uniform(-0.15, 0.15) * x + rng.uniform(-0.15, 0.15) * y
    heights += rng.normal(0.0, draw(st.sampled_from([0.0, 1e-4, 6e-4])), shape)
    for _ in range(draw(st.integers(0, 3))):
        iy, ix = rng.integers(0, 40, 2)
        heights[iy : iy + 9, ix : ix + 12] += rng.choice([0.003, 0.012, 0.06, -0.03, np.nan])
    variance = rng.uniform(0.2, 1.0, shape) * draw(st.sampled_from([1e-9, 3e-7, 9e-6]))
    return gp.assess_terrain(heights, 0.005, origin=(0.5, -0.1), variance=variance)


@pytest.fixture(scope="module", params=[*RECORDED, *further(*OTHERS)])
def recorded(request: pytest.FixtureRequest, data: Path, robot: RobotModel) -> gp.TerrainGrid:
    """Terrain of a recorded scan, or of all recorded scans if they are available."""
    specimen, _, name = request.param.rpartition("/")
    folder = SHARED / specimen if specimen else data
    if not (folder / "scans" / name).is_dir():
        pytest.skip(f"{request.param} is not at hand")
    return gp.process_scan(gp.open_scan(folder / "scans" / name), truth_calibration(folder), robot)


def check_layers(computed: gp.TerrainGrid, received: gp.TerrainGrid) -> None:
    """Check that every layer errs slightly and to its safe side; flags, ages, looks and unknown cells are equal."""
    for name in ("hazard", "age", "looks"):
        np.testing.assert_array_equal(received.layers[name], computed.layers[name])
    known = np.isfinite(computed.elevation)
    layers = ("elevation", "variance", "elevation_min", "elevation_max", "slope", "step_height", "roughness")
    for name in (*layers, "clearance", "traversability"):
        np.testing.assert_array_equal(np.isnan(received.layers[name]), np.isnan(computed.layers[name]))
    change_of = {name: received.layers[name].astype(np.float64) - computed.layers[name] for name in computed.layers}
    off = received.record.checked_rounding.elevation
    assert 0 < off < 1e-4 and received.record.checked_rounding.variance <= 0.125
    assert np.abs(change_of["elevation"][known]).max(initial=0.0) <= off
    assert ((received.elevation_min <= received.elevation) & (received.elevation <= received.elevation_max))[
        known
    ].all()
    for name, most in (("elevation_max", 2 * off), ("step_height", 4 * off), ("roughness", 4 * off), ("slope", 0.002)):
        change = change_of[name][np.isfinite(change_of[name])]
        assert change.min(initial=0.0) >= 0.0 and change.max(initial=0.0) <= most
    for name, most in (("elevation_min", 2 * off), ("clearance", 0.001), ("traversability", 1 / 32)):
        change = change_of[name][np.isfinite(change_of[name])]
        assert change.max(initial=0.0) <= 0.0 and -change.min(initial=0.0) <= most
    grown = received.variance[known].astype(np.float64) - computed.variance[known]
    assert (grown >= 0).all() and (grown <= 0.125 * computed.variance[known].astype(np.float64)).all()
    assert (received.to_occupancy() >= computed.to_occupancy()).all()


def accepted_to(limit: Callable[[float], bool], low: float, high: float) -> float | None:
    """Largest value that is still accepted, to the last bits; None if even the lowest is not."""
    if not limit(low):
        return None
    for _ in range(30):
        halfway = (low + high) / 2
        low, high = (halfway, high) if limit(halfway) else (low, halfway)
    return low


def check_paths(computed: gp.TerrainGrid, received: gp.TerrainGrid, rng: np.random.Generator, count: int) -> int:
    """Check that the original accepts the lowest paths and largest clearances that the received grid accepts."""
    accepted = 0
    x, y = computed.geometry.centres()
    for _ in range(count):
        ends = np.column_stack((rng.choice(x, 2), rng.choice(y, 2)))
        ground = np.nan_to_num(received.height_at(ends[:, 0], ends[:, 1]))
        start, end = np.column_stack((ends + rng.uniform(-0.002, 0.002, (2, 2)), ground))
        lift, shift = rng.uniform(0.02, 0.12), rng.uniform(-0.02, 0.02, 2)
        over = [(*(start[:2] + shift), start[2] + lift), (*(end[:2] + shift), end[2] + lift)]
        path = np.array([start, *over, end])
        clearance = accepted_to(lambda value, path=path: received.check_path(path, value).ok, 0.0, 0.08)
        if clearance is not None:
            accepted += 1
            assert computed.check_path(path, clearance).ok
            assert received.check_path(path, clearance).clearance <= computed.check_path(path, clearance).clearance or (
                np.isnan(computed.check_path(path, clearance).clearance)
            )
        wanted = rng.uniform(0.0, 0.03)
        down = accepted_to(lambda depth, p=path, c=wanted: received.check_path(p - (0, 0, depth), c).ok, -0.1, 0.05)
        if down is not None:
            accepted += 1
            assert computed.check_path(path - (0.0, 0.0, down), wanted).ok
        track = path[:, :2]
        assert computed.check_path(track, 0.01).ok or not received.check_path(track, 0.01).ok
        swing = received.swing(start, end, wanted)
        if swing.ok:
            assert computed.check_path(swing.points, wanted).ok
    return accepted


def check_positions(
    computed: gp.TerrainGrid, received: gp.TerrainGrid, rng: np.random.Generator, leg: str | None
) -> int:
    """Check that the original accepts all footholds, regions and polygons of the received grid; heights agree."""
    x, y = computed.geometry.centres()
    px, py = (a.ravel() for a in np.meshgrid(x, y))
    px, py = px + rng.uniform(-0.0025, 0.0025, px.size), py + rng.uniform(-0.0025, 0.0025, py.size)
    of_received, of_computed = received.check_foothold(px, py, leg), computed.check_foothold(px, py, leg)
    assert (of_received.ok <= of_computed.ok).all() and (of_received.score <= of_computed.score).all()
    assert (received.is_traversable(px, py) <= computed.is_traversable(px, py)).all()
    for region in received.steppable_regions(leg)[:6]:
        weights = rng.dirichlet(np.ones(len(region.vertices)), 40)
        inner = 0.999 * weights @ region.vertices[:, :2] + 0.001 * region.centre
        assert computed.check_foothold(*inner.T, leg).ok.all()
    for wish in rng.choice(px.size, 4):
        best = received.best_foothold(px[wish], py[wish], 0.06, leg)
        if best is not None:
            assert computed.check_foothold(best.x, best.y, leg).ok
        corners = np.array([px[wish], py[wish]]) + rng.uniform(-0.04, 0.04, (3, 2))
        assert computed.check_polygon(corners).ok or not received.check_polygon(corners).ok
    points = np.column_stack((px, py))
    of_received, of_computed = received.height_scan(points), computed.height_scan(points)
    np.testing.assert_array_equal(of_received.known, of_computed.known)
    assert (
        np.abs(of_received.heights - of_computed.heights)[of_received.known].max(initial=0.0) <= ROUNDING["elevation"]
    )
    assert (of_received.sigma >= of_computed.sigma)[of_received.known].all()
    return int(computed.check_foothold(px, py, leg).ok.sum())


def with_body_moved(terrain: gp.TerrainGrid, forward: float, up: float) -> gp.TerrainGrid:
    """Grid with the body moved forward and up [m], so that legs reach into the grid."""
    pose = np.array(terrain.metadata["transform_base_to_footprint"])
    pose[[0, 2], 3] += forward, up
    return dataclasses.replace(
        terrain, record=ScanRecord.from_json({**terrain.metadata, "transform_base_to_footprint": pose.tolist()})
    )


@pytest.mark.slow
@PROPERTY
@given(worlds(), st.integers(0, 10_000))
def test_no_question_is_answered_better_than_on_the_computed_grid(terrain: gp.TerrainGrid, seed: int) -> None:
    """Any ground and any variance, with queries at the limit of what is accepted."""
    received = sent_compactly(terrain)
    check_layers(terrain, received)
    rng = np.random.default_rng(seed)
    check_paths(terrain, received, rng, 4)
    check_positions(terrain, received, rng, None)


@pytest.mark.slow
@PROPERTY
@given(worlds())
def test_no_distance_is_larger_and_coarser_grids_are_answered_no_better(terrain: gp.TerrainGrid) -> None:
    """Distance fields, and grids with cells twice as long."""
    received = sent_compactly(terrain)
    for computed, other in ((terrain, received), (terrain.coarser(2), received.coarser(2))):
        assert (other.distance_field(-0.05, 0.1).values <= computed.distance_field(-0.05, 0.1).values).all()
        check_positions(computed, other, np.random.default_rng(0), None)


@pytest.mark.slow
def test_recorded_scans_are_answered_no_better(recorded: gp.TerrainGrid) -> None:
    """Layers, paths and positions on grids of recorded scans."""
    received = sent_compactly(recorded)
    check_layers(recorded, received)
    rng = np.random.default_rng(7)
    check_paths(recorded, received, rng, 15)
    check_positions(recorded, received, rng, None)
    over = with_body_moved(recorded, 0.35, -0.03)
    assert check_positions(over, sent_compactly(over), rng, "lf") > 0


@pytest.mark.slow
def test_a_leg_at_the_end_of_its_reach_is_not_made_longer(paper_terrain: gp.TerrainGrid) -> None:
    """20 random body positions with the limit of reach on the grid: no foothold is gained, few are lost."""
    rng = np.random.default_rng(3)
    x, y = (a.ravel() for a in np.meshgrid(*paper_terrain.geometry.centres()))
    fewer = at_the_border = 0
    for forward, up in rng.uniform([0.2, -0.1], [0.4, 0.035], (20, 2)):
        computed = with_body_moved(paper_terrain, forward, up)
        of_received = sent_compactly(computed).check_foothold(x, y, "lf").ok
        of_computed = computed.check_foothold(x, y, "lf").ok
        assert (of_received <= of_computed).all()
        at_the_border += bool(of_computed.any())
        fewer += int((of_computed & ~of_received).sum())
    assert at_the_border > 10 and 0 < fewer < 100


@pytest.mark.slow
def test_what_it_costs_is_little(paper_terrain: gp.TerrainGrid) -> None:
    """On a recorded scan, no foothold and at most a fifth of the steppable regions are lost."""
    received = sent_compactly(paper_terrain)
    x, y = (a.ravel() for a in np.meshgrid(*paper_terrain.geometry.centres()))
    of_computed = paper_terrain.check_foothold(x, y).ok
    assert of_computed.sum() > 500 and received.check_foothold(x, y).ok.sum() == of_computed.sum()
    assert len(received.steppable_regions()) >= 0.8 * len(paper_terrain.steppable_regions()) > 0


@pytest.mark.slow
def test_a_compact_grid_is_not_fused(paper_terrain: gp.TerrainGrid, robot: RobotModel) -> None:
    """The map could not keep the bounds of the rounding."""
    with pytest.raises(gp.InvalidInput, match="compact encoding cannot be fused, .* Request the lossless grid"):
        gp.TerrainMap(robot).update(sent_compactly(paper_terrain), PoseInOdom(np.eye(4), 1e-8 * np.eye(6)))


@pytest.mark.parametrize("rounding", [{}, {"elevation": 1e-4}, {"elevation": -1, "variance": 0}, 3, {"elevation": "x"}])
def test_a_grid_with_impossible_rounding_is_refused(paper_terrain: gp.TerrainGrid, rounding: object) -> None:
    """Every query that needs the bounds of the rounding rejects the grid."""
    metadata = {**paper_terrain.metadata, "rounding": rounding}
    broken = dataclasses.replace(paper_terrain, record=ScanRecord.from_json(metadata))
    with pytest.raises(gp.InvalidInput, match=r"has rounding = .*allowed: an object of elevation \[m\] and variance"):
        broken.check_path([(0.6, 0.0, 0.1), (0.7, 0.0, 0.1)], 0.01)
    with pytest.raises(gp.InvalidInput, match="has rounding"):
        broken.steppable_regions()
    with pytest.raises(gp.InvalidInput, match="has rounding"):
        broken.check_foothold(0.7, 0.0, "lf")
