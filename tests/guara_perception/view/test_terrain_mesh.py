"""Tests of the terrain as it is drawn in 3-D."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.exceptions import InvalidInput
from guara_perception.terrain.drawing import style
from guara_perception.view.terrain_mesh import terrain_mesh


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
