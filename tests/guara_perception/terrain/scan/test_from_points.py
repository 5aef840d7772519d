"""Points of another sensor: known where they fell, causes elsewhere, and the same invariant as for stripes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import guara_perception as gp
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK
from kinematics import RobotModel
from tests.thorough import examples

EYE = (0.40, 0.0, 0.50)


def cloud(box: float = 0.0, seed: int = 0) -> np.ndarray:
    """Points every 2 mm over the scanned area, on level ground with a box; what the box hides from the eye is cut."""
    x, y = (a.ravel() for a in np.meshgrid(np.arange(0.501, 0.95, 0.002), np.arange(-0.269, 0.27, 0.002)))
    on_box = (np.abs(x - 0.65) < 0.03) & (np.abs(y) < 0.04)
    z = np.where(on_box, box, 0.0)
    behind = ~on_box & (np.abs(y) < 0.04 * 1.2) & (x > 0.68) & (x < 0.68 + 0.28 * box / max(0.5 - box, 1e-9))
    keep = ~behind if box else np.ones(x.size, dtype=bool)
    return np.column_stack((x, y, z + np.random.default_rng(seed).normal(0, 3e-4, x.size)))[keep]


def test_level_ground_is_known_and_free(robot: RobotModel) -> None:
    """All cells known, the deep ones free; heights and variances are those of the points."""
    terrain = gp.terrain_from_points(cloud(), 0.0003, EYE, robot, step=3)
    assert terrain.extent == "footprint"
    assert terrain.step == 3
    assert not (terrain.hazard & UNKNOWN_MASK).any()
    assert (terrain.traversability[20:-20, 20:-20] > 0).all()
    assert np.abs(terrain.elevation).max() < 0.001
    assert np.sqrt(terrain.variance).max() < 0.0005
    assert gp.terrain_from_points(cloud(), 0.0003, EYE).geometry == terrain.geometry


def test_behind_a_box_is_occluded(robot: RobotModel) -> None:
    """What a box hides from the sensor is unknown for that cause, its top and sides are hazards."""
    terrain = gp.terrain_from_points(cloud(0.08), 0.0003, EYE, robot)
    assert terrain.height_at(0.65, 0.0) == pytest.approx(0.08, abs=0.001)
    assert terrain.hazard_at(0.70, 0.0) & gp.Hazard.OCCLUDED
    assert not terrain.is_traversable(0.62, 0.0)
    assert terrain.is_traversable(0.60, 0.18)


def test_where_nothing_fell_is_unscanned_and_where_it_looked_in_vain_a_dropout(robot: RobotModel) -> None:
    """A gap in the cloud is UNSCANNED; with the rays that returned nothing it is a DROPOUT, and the map forgets it."""
    points = cloud()
    gap = (np.abs(points[:, 0] - 0.7) < 0.02) & (np.abs(points[:, 1]) < 0.02)
    terrain = gp.terrain_from_points(points[~gap], 0.0003, EYE, robot, step=1)
    assert terrain.hazard_at(0.7, 0.0) == gp.Hazard.UNSCANNED
    rays = points[gap] - EYE
    looked = gp.terrain_from_points(points[~gap], 0.0003, EYE, robot, step=1, no_returns=rays)
    assert looked.hazard_at(0.7, 0.0) == gp.Hazard.DROPOUT
    before = gp.terrain_from_points(points, 0.0003, EYE, robot, step=0)
    for scan, kept in ((terrain, True), (looked, False)):
        terrain_map = gp.TerrainMap(robot)
        terrain_map.update(before, np.eye(4), np.zeros((6, 6)))
        fused = terrain_map.update(scan, np.eye(4), np.zeros((6, 6)))
        assert np.isfinite(fused.height_at(0.7, 0.0)) == kept


def test_heights_outside_the_gates_are_out_of_range(robot: RobotModel) -> None:
    """Something that rises above the gate leaves its cell unknown for that cause, whatever else fell there."""
    points = np.concatenate((cloud(), [[0.7, 0.1, 0.4], [0.7, -0.1, -0.3]]))
    terrain = gp.terrain_from_points(points, 0.0003, EYE, robot)
    for y in (0.1, -0.1):
        assert terrain.hazard_at(0.7, y) == gp.Hazard.OUT_OF_RANGE
        assert not terrain.is_traversable(0.7, y + 0.03)


@pytest.mark.slow
@settings(max_examples=examples(15), deadline=None, derandomize=True)
@given(st.integers(0, 1000), st.floats(0.0, 0.1))
def test_losing_the_points_of_any_cells_frees_no_other(seed: int, box: float) -> None:
    """All points of a random patch are lost: no cell is free that was not before."""
    rng = np.random.default_rng(seed)
    points = cloud(box, seed)
    x, y = rng.uniform(0.5, 0.95), rng.uniform(-0.27, 0.27)
    size = rng.uniform(0.002, 0.1, 2)
    low = np.floor((np.array([x, y]) - size) / 0.005) * 0.005
    high = np.ceil((np.array([x, y]) + size) / 0.005) * 0.005
    lost = ((points[:, :2] >= low) & (points[:, :2] < high)).all(axis=1)
    before = gp.terrain_from_points(points, 0.0003, EYE)
    after = gp.terrain_from_points(points[~lost], 0.0003, EYE)
    assert not ((after.hazard == 0) & (before.hazard != 0)).any()


def test_no_points_know_nothing() -> None:
    """An empty cloud gives a grid of unknown cells, and says so."""
    terrain = gp.terrain_from_points(np.empty((0, 3)), 0.001, EYE)
    assert ((terrain.hazard & UNKNOWN_MASK) != 0).all()
    assert terrain.metadata["health"]["reasons"] == ["no point was used"]


@pytest.mark.parametrize(
    ("points", "sigma", "origin", "message"),
    [
        (np.zeros((4, 2)), 0.001, EYE, r"points have shape \(4, 2\), \(n, 3\) is needed"),
        ("points", 0.001, EYE, "points: an array of numbers is needed"),
        (np.zeros((4, 3)), -1.0, EYE, "sigma must be one number or one for each point"),
        (np.zeros((4, 3)), [0.1, 0.1], EYE, "sigma must be one number or one for each point"),
        (np.zeros((4, 3)), 0.001, (0, 0), "sensor_origin has shape"),
        (np.zeros((4, 3)), 0.001, (0, np.nan, 1), "sensor_origin has shape"),
    ],
)
def test_what_is_no_cloud_is_refused(points: object, sigma: object, origin: object, message: str) -> None:
    """Shapes and numbers are checked, with what is needed."""
    with pytest.raises(gp.InvalidInput, match=message):
        gp.terrain_from_points(points, sigma, origin)  # type: ignore[arg-type]
