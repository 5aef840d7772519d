"""The distance field is a lower bound of the distance from the ground."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import guara_perception as gp
from tests.thorough import examples

PROPERTY = settings(max_examples=examples(25), deadline=None, derandomize=True)
SIGMA = 0.0005


def ground(seed: int) -> gp.TerrainGrid:
    """0.2 x 0.3 m with boxes and unknown cells."""
    rng = np.random.default_rng(seed)
    heights = rng.normal(0, 0.001, (40, 60))
    for _ in range(3):
        iy, ix = rng.integers(0, 34, 2)
        heights[iy : iy + 6, ix : ix + 6] += rng.uniform(0.01, 0.06)
    heights[rng.random(heights.shape) < 0.002] = np.nan
    return gp.assess_terrain(heights, 0.005, origin=(0.5, -0.1), variance=np.full(heights.shape, SIGMA**2))


def exact(terrain: gp.TerrainGrid, point: np.ndarray) -> float:
    """Distance of a point from the columns of ground, and from everything unknown or off the grid."""
    x, y = np.meshgrid(*terrain.geometry.centres())
    half = terrain.resolution / 2
    aside = np.hypot(np.maximum(np.abs(x - point[0]) - half, 0), np.maximum(np.abs(y - point[1]) - half, 0))
    over = np.maximum(point[2] - (terrain.elevation_max.astype(float) + 2 * SIGMA), 0)
    columns = np.hypot(aside, np.where(np.isnan(terrain.elevation), 0.0, over)).min()
    (x0, y0), (ny, nx) = terrain.origin, terrain.shape
    border = min(point[0] - x0, x0 + 0.005 * nx - point[0], point[1] - y0, y0 + 0.005 * ny - point[1])
    return float(min(columns, border))


@pytest.mark.slow
@PROPERTY
@given(st.integers(0, 500))
def test_never_more_than_there_is_and_not_much_less(seed: int) -> None:
    """Random points, brute force: at most the distance, and at least that minus the size of a voxel."""
    terrain = ground(seed)
    field = terrain.distance_field(-0.02, 0.12)
    rng = np.random.default_rng(seed)
    points = np.column_stack((rng.uniform(0.5, 0.8, 60), rng.uniform(-0.1, 0.1, 60), rng.uniform(-0.02, 0.12, 60)))
    for point, distance in zip(points, field.at(points), strict=True):
        true = exact(terrain, point)
        assert distance <= true + 1e-6
        assert distance >= true - (1 + 1.5 * np.sqrt(3)) * 0.005 - 1e-6 or true == 0


def test_beside_above_and_below() -> None:
    """Beside and below the field nothing is free, above it the distance is not computed."""
    field = ground(0).distance_field(0.0, 0.1)
    assert field.values.shape == (20, 40, 60)
    values = field.at([[0.49, 0.0, 0.05], [0.6, 0.0, -0.01], [0.6, 0.0, 0.2]])
    assert values[0] == values[1] == -np.inf and np.isnan(values[2])


def test_unknown_ground_is_solid_at_every_height() -> None:
    """Its height is unknown."""
    heights = np.zeros((20, 20))
    heights[10, 10] = np.nan
    field = gp.assess_terrain(heights, 0.005, variance=np.full(heights.shape, 1e-8)).distance_field(0.0, 0.05)
    assert (field.values[:, 10, 10] <= 0).all()


def test_what_is_refused() -> None:
    """Heights in the wrong order, too many voxels, points of another shape."""
    terrain = ground(0)
    with pytest.raises(gp.InvalidInput, match="high above low"):
        terrain.distance_field(0.1, 0.0)
    with pytest.raises(gp.InvalidInput, match="reduce the height range"):
        terrain.distance_field(0.0, 1000.0)
    with pytest.raises(gp.InvalidInput, match=r"\(n, 3\)"):
        terrain.distance_field(0.0, 0.1).at([1.0, 2.0, 3.0])
