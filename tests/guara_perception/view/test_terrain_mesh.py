"""Tests of the terrain as it is drawn in 3-D."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import guara_perception as gp
from guara_perception.exceptions import InvalidInput
from guara_perception.terrain.drawing import style
from guara_perception.view.terrain_mesh import drawn_heights, met_by_ray, terrain_mesh
from tests.thorough import examples

LEVEL = gp.assess_terrain(np.zeros((108, 140)), 0.005, origin=(0.0, -0.27))


def test_the_mesh_lies_on_the_grid(grid: gp.TerrainGrid) -> None:
    """Vertices are centres of known cells at their height; triangles face up and cross no wall."""
    mesh = terrain_mesh(grid, "elevation")
    known = np.isfinite(grid.elevation)
    assert len(mesh.vertices) == known.sum()
    np.testing.assert_allclose(grid.height_at(mesh.vertices[:, 0], mesh.vertices[:, 1]), mesh.vertices[:, 2], atol=1e-6)
    one, two, three = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
    assert (np.cross(two - one, three - one)[:, 2] > 0).all()
    assert np.ptp(mesh.vertices[mesh.faces, 2], axis=1).max() < 0.03


def test_a_vertex_has_the_colour_of_its_cell(grid: gp.TerrainGrid) -> None:
    """The texture position of a vertex lies in its own cell; unknown cells show their cause in hazard colours."""
    mesh = terrain_mesh(grid, "hazard")
    ny, nx = grid.shape
    column = np.floor(mesh.texture_positions[:, 0] * nx).astype(int)
    row = np.floor((1 - mesh.texture_positions[:, 1]) * ny).astype(int)
    iy, ix = grid.geometry.indices(mesh.vertices[:, 0], mesh.vertices[:, 1])
    np.testing.assert_array_equal(row, iy)
    np.testing.assert_array_equal(column, ix)
    wanted = np.round(style.hazard_picture(grid.hazard)[0] * 255)
    np.testing.assert_array_equal(mesh.picture, wanted)
    assert "free" in dict(mesh.legend)
    assert "unscanned" not in dict(mesh.legend)


def test_other_colourings_have_a_scale_and_unknown_ones_are_refused(grid: gp.TerrainGrid) -> None:
    """Heights from lowest to highest in whole centimetres, traversability from 0 to 1; others are refused by name."""
    heights = terrain_mesh(grid, "elevation")
    assert heights.legend == () and heights.scale is not None
    assert (heights.scale.low, heights.scale.high) == pytest.approx((0.0, 0.06))
    assert (heights.scale.low_text, heights.scale.high_text) == ("+0 mm", "+60 mm")
    traversability = terrain_mesh(grid, "traversability").scale
    assert traversability is not None and (traversability.low, traversability.high) == (0.0, 1.0)
    with pytest.raises(InvalidInput, match="colouring is 'slope', allowed: hazard, elevation, traversability"):
        terrain_mesh(grid, "slope")


@pytest.mark.parametrize("colouring", ["elevation", "traversability"])
def test_unknown_cells_are_grey_on_every_scale(grid: gp.TerrainGrid, colouring: str) -> None:
    """What was looked at without a height is drawn in the grey that the legend names, what is known never is."""
    hazard = grid.hazard.copy()
    unknown = ~np.isfinite(grid.elevation)
    hazard[unknown] = np.uint16(gp.Hazard.DROPOUT)
    looked_at = dataclasses.replace(grid, layers={**grid.layers, "hazard": hazard})
    mesh = terrain_mesh(looked_at, colouring)
    grey = np.round(255 * np.array(style.rgb(style.UNKNOWN_COLOUR)))
    is_grey = (mesh.picture == grey).all(axis=-1)
    np.testing.assert_array_equal(is_grey, unknown)
    assert len(mesh.vertices) == grid.elevation.size


def test_an_unknown_grid_has_an_empty_mesh() -> None:
    """Where nothing is known nothing is drawn."""
    mesh = terrain_mesh(gp.assess_terrain(np.full((5, 6), np.nan), 0.01), "elevation")
    assert mesh.vertices.shape == (0, 3)
    assert mesh.faces.shape == (0, 3)


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
