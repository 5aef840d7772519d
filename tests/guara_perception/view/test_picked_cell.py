"""Tests of what a click on the terrain means."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import guara_perception as gp
from guara_perception.view.picked_cell import met_by_ray
from guara_perception.view.terrain_mesh import drawn_heights
from tests.thorough import examples

LEVEL = gp.assess_terrain(np.zeros((108, 140)), 0.005, origin=(0.0, -0.27))


@settings(max_examples=examples(60), deadline=None)
@given(x=st.floats(0.02, 0.6), y=st.floats(-0.25, 0.25), view_x=st.floats(-1, 1), view_y=st.floats(-1, 1))
def test_on_level_ground_a_ray_meets_what_it_aims_at(x: float, y: float, view_x: float, view_y: float) -> None:
    """From any side, to less than a cell."""
    viewpoint = np.array([view_x, view_y, 0.8])
    met = met_by_ray(LEVEL, viewpoint, 3.0 * (np.array([x, y, 0.0]) - viewpoint))
    assert met is not None
    np.testing.assert_allclose(met, (x, y, 0.0), atol=0.004)


def test_the_first_thing_in_the_way_is_met(grid: gp.TerrainGrid) -> None:
    """A ray to the ground behind a box meets the box, on the side from which it comes."""
    viewpoint, behind = np.array([0.0, 0.1, 0.15]), np.array([0.80, 0.1, 0.0])
    met = met_by_ray(grid, viewpoint, behind - viewpoint)
    assert met is not None
    assert met[0] == pytest.approx(0.65, abs=0.01) and 0.0 < met[2] < 0.06
    # From behind it is free.
    other = np.array([1.6, 0.1, 0.15])
    met = met_by_ray(grid, other, behind - other)
    assert met is not None and met[0] == pytest.approx(0.80, abs=0.01)


def test_what_is_met_lies_on_what_is_drawn(grid: gp.TerrainGrid) -> None:
    """Unknown cells too: they are clicked where they are drawn."""
    x, y = grid.geometry.centres()
    unknown = np.argwhere(~np.isfinite(grid.elevation))[37]
    aim = np.array([x[unknown[1]], y[unknown[0]], drawn_heights(grid)[tuple(unknown)]])
    met = met_by_ray(grid, aim + (0, 0, 0.5), (0, 0, -1))
    assert met is not None and "is unknown" in grid.explain(met[0], met[1])


@pytest.mark.parametrize(
    ("origin", "direction"),
    [((0.5, 0, 0.5), (0, 0, 1)), ((5, 5, 0.5), (0, 0, -1)), ((0.5, 0, 0.5), (1, 0, 0)), ((0, 0, 0.5), (-1, 0, -1))],
)
def test_a_ray_that_passes_by_meets_nothing(
    grid: gp.TerrainGrid, origin: tuple[float, ...], direction: tuple[float, ...]
) -> None:
    """Upwards, beside, above, away."""
    assert met_by_ray(grid, origin, direction) is None
