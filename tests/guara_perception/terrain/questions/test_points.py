"""Points and data sets of a grid contain exactly the known cells."""

from __future__ import annotations

import builtins
import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import guara_perception as gp
from guara_perception.exceptions import MissingExtra
from guara_perception.terrain.layers.record import ScanRecord
from kinematics import RobotModel, Stance
from tests.thorough import examples


@pytest.fixture
def terrain(make_scan) -> gp.TerrainGrid:
    """Slope along x with an unobserved hole."""
    heights = np.tile(np.linspace(0, 0.01, 90), (108, 1))
    flags = np.zeros((108, 90), np.uint16)
    flags[10:20, 30:40] = gp.Hazard.OCCLUDED
    return make_scan(heights, flags=flags)


def test_points_are_the_known_cells(terrain):
    """There are as many points as known cells, each in the cell of its height."""
    points = terrain.points()
    assert points.shape == (108 * 90 - 100, 3) and points.dtype == np.float64
    assert np.array_equal(terrain.height_at(points[:, 0], points[:, 1]), points[:, 2].astype(np.float32))
    assert np.isfinite(points).all()


def test_a_grid_that_knows_nothing_has_no_points(make_scan):
    """Unknown cells give no points."""
    assert make_scan(0.0, flags=int(gp.Hazard.DROPOUT)).points().shape == (0, 3)


@pytest.mark.slow
def test_data_set_has_every_layer_on_its_coordinates(terrain):
    """Selection by position in xarray gives the values of the grid."""
    xarray = pytest.importorskip("xarray", reason="extra notebook")
    data = terrain.to_xarray()
    assert isinstance(data, xarray.Dataset) and set(data.data_vars) == set(terrain.layers)
    picked = data.elevation.sel(x=0.7, y=0.1, method="nearest")
    assert float(picked) == terrain.height_at(float(picked.x), float(picked.y))
    assert data.attrs["frame"] == "base_footprint" and data.x.attrs["units"] == "m"


def test_without_xarray_one_line_says_what_to_install(terrain, monkeypatch):
    """The message names the extra."""
    real = builtins.__import__

    def refuse(name, *args, **options):
        if name.split(".")[0] == "xarray":
            raise ImportError(name)
        return real(name, *args, **options)

    monkeypatch.setattr(builtins, "__import__", refuse)
    monkeypatch.setitem(__import__("sys").modules, "xarray", None)
    with pytest.raises(MissingExtra, match=r"to_xarray needs xarray: pip install 'guara-perception\[notebook\]'"):
        terrain.to_xarray()


@pytest.mark.slow
@settings(max_examples=examples(40), deadline=None, derandomize=True)
@given(st.integers(0, 1000), st.integers(0, 60))
def test_what_is_known_is_the_grids_height_and_nothing_else(seed: int, count: int) -> None:
    """Known exactly where the cell is, with its height and sigma; NaN off the grid and over holes."""
    rng = np.random.default_rng(seed)
    heights = rng.normal(0, 0.01, (40, 50))
    heights[rng.random(heights.shape) < 0.3] = np.nan
    terrain = gp.assess_terrain(heights, 0.01, variance=np.full(heights.shape, 0.002**2))
    points = rng.uniform(-0.1, 0.6, (count, 2))
    scan = terrain.height_scan(points)
    assert len(scan) == count
    np.testing.assert_array_equal(scan.heights, terrain.height_at(points[:, 0], points[:, 1]))
    np.testing.assert_array_equal(scan.known, np.isfinite(scan.heights))
    np.testing.assert_array_equal(np.isfinite(scan.sigma), scan.known)
    np.testing.assert_allclose(scan.sigma[scan.known], 0.002, rtol=1e-5)
    np.testing.assert_allclose(scan.below, -scan.heights)


def test_points_of_the_body_are_moved_by_its_pose(robot: RobotModel) -> None:
    """A point 0.1 m below a body at a height of 0.36 m is 0.26 m above level ground."""
    stance = Stance(robot.posture("scan"), robot.legs, (0, 0, -1))
    pose = robot.stance_pose(stance)
    terrain = gp.assess_terrain(np.zeros((140, 320)), 0.005, origin=(-0.6, -0.35))
    pose_metadata = {"transform_base_to_footprint": pose.transform_base_to_footprint.tolist()}
    terrain = dataclasses.replace(terrain, record=ScanRecord.from_json({**terrain.metadata, **pose_metadata}))
    scan = terrain.height_scan([[0.2, 0.1, -0.1], [5.0, 0.0, 0.0]], frame="base_link")
    assert scan.known.tolist() == [True, False]
    assert scan.below[0] == pytest.approx(pose.height - 0.1, abs=1e-6)
    assert np.isnan(scan.below[1])
    with pytest.raises(ValueError, match="read-only"):
        scan.heights[0] = 0.0


@pytest.mark.parametrize(
    ("points", "frame", "message"),
    [
        ([0.1, 0.2], "base_footprint", r"shape \(2,\); \(n, 2\) or \(n, 3\) is needed"),
        ("here", "base_footprint", "points: an array of numbers"),
        ([[0.1, 0.2]], "map", "frame is 'map', allowed: base_footprint, base_link"),
        ([[0.1, 0.2]], "base_link", "lacks transform_base_to_footprint"),
    ],
)
def test_bad_questions_are_refused(points: object, frame: str, message: str) -> None:
    """Points of another shape, an unknown frame, a grid without the pose of the body."""
    with pytest.raises(gp.InvalidInput, match=message):
        gp.assess_terrain(np.zeros((4, 4)), 0.1).height_scan(points, frame)  # type: ignore[arg-type]
