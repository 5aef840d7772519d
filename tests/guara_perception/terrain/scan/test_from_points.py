"""Grids from the points of another sensor: known where points are, with a cause elsewhere; loss frees no cell."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import guara_perception as gp
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK
from kinematics import PoseInOdom, RobotModel
from tests.thorough import examples

SENSOR_ORIGIN = (0.40, 0.0, 0.50)
ZERO = np.zeros((6, 6))


def cloud(box: float = 0.0, seed: int = 0) -> np.ndarray:
    """Points every 2 mm on level ground with a box, without those that the box hides from the sensor."""
    x, y = (a.ravel() for a in np.meshgrid(np.arange(0.501, 0.95, 0.002), np.arange(-0.269, 0.27, 0.002)))
    on_box = (np.abs(x - 0.65) < 0.03) & (np.abs(y) < 0.04)
    z = np.where(on_box, box, 0.0)
    behind = ~on_box & (np.abs(y) < 0.04 * 1.2) & (x > 0.68) & (x < 0.68 + 0.28 * box / max(0.5 - box, 1e-9))
    keep = ~behind if box else np.ones(x.size, dtype=bool)
    return np.column_stack((x, y, z + np.random.default_rng(seed).normal(0, 3e-4, x.size)))[keep]


def test_level_ground_is_known_and_free(robot: RobotModel) -> None:
    """All cells are known, those away from the border are free; heights and variances are those of the points."""
    terrain = gp.terrain_from_points(cloud(), 0.0003, SENSOR_ORIGIN, robot, step=3)
    assert terrain.extent == "footprint"
    assert terrain.step == 3
    assert not (terrain.hazard & UNKNOWN_MASK).any()
    assert (terrain.traversability[20:-20, 20:-20] > 0).all()
    assert np.abs(terrain.elevation).max() < 0.001
    assert np.sqrt(terrain.variance).max() < 0.0005
    assert gp.terrain_from_points(cloud(), 0.0003, SENSOR_ORIGIN).geometry == terrain.geometry


def test_ground_behind_a_box_is_occluded(robot: RobotModel) -> None:
    """Ground hidden by a box is OCCLUDED; close in front of the box no foot may stand, well beside it one may."""
    terrain = gp.terrain_from_points(cloud(0.08), 0.0003, SENSOR_ORIGIN, robot)
    assert terrain.height_at(0.65, 0.0) == pytest.approx(0.08, abs=0.001)
    assert terrain.hazard_at(0.70, 0.0) & gp.Hazard.OCCLUDED
    assert not terrain.is_traversable(0.62, 0.0)
    assert terrain.is_traversable(0.60, 0.18)


@pytest.mark.slow
def test_a_gap_is_unscanned_or_with_rays_without_return_a_dropout(robot: RobotModel) -> None:
    """A gap is UNSCANNED and kept by the map; with rays without a return it is DROPOUT and forgotten."""
    points = cloud()
    gap = (np.abs(points[:, 0] - 0.7) < 0.02) & (np.abs(points[:, 1]) < 0.02)
    terrain = gp.terrain_from_points(points[~gap], 0.0003, SENSOR_ORIGIN, robot, step=1)
    assert terrain.hazard_at(0.7, 0.0) == gp.Hazard.UNSCANNED
    rays = points[gap] - SENSOR_ORIGIN
    looked = gp.terrain_from_points(points[~gap], 0.0003, SENSOR_ORIGIN, robot, step=1, no_returns=rays)
    assert looked.hazard_at(0.7, 0.0) == gp.Hazard.DROPOUT
    before = gp.terrain_from_points(points, 0.0003, SENSOR_ORIGIN, robot, step=0)
    for scan, kept in ((terrain, True), (looked, False)):
        terrain_map = gp.TerrainMap(robot)
        terrain_map.update(before, PoseInOdom(np.eye(4), ZERO))
        fused = terrain_map.update(scan, PoseInOdom(np.eye(4), ZERO))
        assert np.isfinite(fused.height_at(0.7, 0.0)) == kept


def test_ground_of_which_nothing_returns_is_forgotten(robot: RobotModel) -> None:
    """With rays and without points, each cell that a ray meets is DROPOUT, and the map forgets all."""
    points = cloud()
    nothing = gp.terrain_from_points(
        np.zeros((0, 3)), 0.0003, SENSOR_ORIGIN, robot, step=1, no_returns=points - SENSOR_ORIGIN
    )
    terrain_map = gp.TerrainMap(robot)
    terrain_map.update(gp.terrain_from_points(points, 0.0003, SENSOR_ORIGIN, robot), PoseInOdom(np.eye(4), ZERO))
    fused = terrain_map.update(nothing, PoseInOdom(np.eye(4), ZERO))
    for x, y in ((0.7, 0.0), (0.6, 0.2), (0.85, -0.1)):
        assert nothing.hazard_at(x, y) == gp.Hazard.DROPOUT
        assert not fused.is_traversable(x, y) and np.isnan(fused.height_at(x, y))


def test_points_outside_the_height_limits_are_out_of_range(robot: RobotModel) -> None:
    """A cell with a point beyond the height limits is OUT_OF_RANGE, whatever its other points."""
    points = np.concatenate((cloud(), [[0.7, 0.1, 0.4], [0.7, -0.1, -0.3]]))
    terrain = gp.terrain_from_points(points, 0.0003, SENSOR_ORIGIN, robot)
    for y in (0.1, -0.1):
        assert terrain.hazard_at(0.7, y) == gp.Hazard.OUT_OF_RANGE
        assert not terrain.is_traversable(0.7, y + 0.03)


@pytest.mark.slow
@settings(max_examples=examples(15), deadline=None, derandomize=True)
@given(st.integers(0, 1000), st.floats(0.0, 0.1))
def test_losing_the_points_of_any_cells_frees_no_other(seed: int, box: float) -> None:
    """Without the points of a random patch, no cell is free that was not free with them."""
    rng = np.random.default_rng(seed)
    points = cloud(box, seed)
    x, y = rng.uniform(0.5, 0.95), rng.uniform(-0.27, 0.27)
    size = rng.uniform(0.002, 0.1, 2)
    low = np.floor((np.array([x, y]) - size) / 0.005) * 0.005
    high = np.ceil((np.array([x, y]) + size) / 0.005) * 0.005
    lost = ((points[:, :2] >= low) & (points[:, :2] < high)).all(axis=1)
    before = gp.terrain_from_points(points, 0.0003, SENSOR_ORIGIN)
    after = gp.terrain_from_points(points[~lost], 0.0003, SENSOR_ORIGIN)
    assert not ((after.hazard == 0) & (before.hazard != 0)).any()


def test_an_empty_cloud_gives_unknown_cells() -> None:
    """Every cell is unknown, and the health gives the reason."""
    terrain = gp.terrain_from_points(np.empty((0, 3)), 0.001, SENSOR_ORIGIN)
    assert ((terrain.hazard & UNKNOWN_MASK) != 0).all()
    assert terrain.metadata["health"]["reasons"] == ["no point was used"]


@pytest.mark.parametrize(
    ("points", "sigma", "origin", "message"),
    [
        (np.zeros((4, 2)), 0.001, SENSOR_ORIGIN, r"points have shape \(4, 2\); allowed: \(n, 3\)"),
        ("points", 0.001, SENSOR_ORIGIN, "points: an array of numbers is needed"),
        (np.zeros((4, 3)), -1.0, SENSOR_ORIGIN, "sigma must be one number or one for each point"),
        (np.zeros((4, 3)), [0.1, 0.1], SENSOR_ORIGIN, "sigma must be one number or one for each point"),
        (np.zeros((4, 3)), 0.001, (0, 0), "sensor_origin has shape"),
        (np.zeros((4, 3)), 0.001, (0, np.nan, 1), "sensor_origin has shape"),
    ],
)
def test_points_of_another_shape_are_refused(points: object, sigma: object, origin: object, message: str) -> None:
    """Also sigmas and origins; the message says what is needed."""
    with pytest.raises(gp.InvalidInput, match=message):
        gp.terrain_from_points(points, sigma, origin)  # type: ignore[arg-type]
