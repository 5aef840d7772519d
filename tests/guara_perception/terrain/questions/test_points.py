"""Points and data sets of a grid: the known cells, and nothing else."""

from __future__ import annotations

import builtins

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.extras import MissingExtra


@pytest.fixture
def terrain(make_scan) -> gp.TerrainGrid:
    """A slope along x with a hole that nobody saw."""
    heights = np.tile(np.linspace(0, 0.01, 90), (108, 1))
    flags = np.zeros((108, 90), np.uint16)
    flags[10:20, 30:40] = gp.Hazard.OCCLUDED
    return make_scan(heights, flags=flags)


def test_points_are_the_known_cells(terrain):
    """As many points as known cells; each lies in the cell whose height it has."""
    points = terrain.points()
    assert points.shape == (108 * 90 - 100, 3) and points.dtype == np.float64
    assert np.array_equal(terrain.height_at(points[:, 0], points[:, 1]), points[:, 2].astype(np.float32))
    assert np.isfinite(points).all()


def test_a_grid_that_knows_nothing_has_no_points(make_scan):
    """No made-up point for an unknown cell."""
    assert make_scan(0.0, flags=int(gp.Hazard.DROPOUT)).points().shape == (0, 3)


@pytest.mark.slow
def test_data_set_has_every_layer_on_its_coordinates(terrain):
    """xarray selects by position and finds what the grid says there."""
    xarray = pytest.importorskip("xarray", reason="extra notebook")
    data = terrain.to_xarray()
    assert isinstance(data, xarray.Dataset) and set(data.data_vars) == set(terrain.layers)
    picked = data.elevation.sel(x=0.7, y=0.1, method="nearest")
    assert float(picked) == terrain.height_at(float(picked.x), float(picked.y))
    assert data.attrs["frame"] == "base_footprint" and data.x.attrs["units"] == "m"


def test_without_xarray_one_line_says_what_to_install(terrain, monkeypatch):
    """The extra is named."""
    real = builtins.__import__

    def refuse(name, *args, **options):
        if name.split(".")[0] == "xarray":
            raise ImportError(name)
        return real(name, *args, **options)

    monkeypatch.setattr(builtins, "__import__", refuse)
    monkeypatch.setitem(__import__("sys").modules, "xarray", None)
    with pytest.raises(MissingExtra, match=r"to_xarray needs xarray: pip install 'guara-perception\[notebook\]'"):
        terrain.to_xarray()
