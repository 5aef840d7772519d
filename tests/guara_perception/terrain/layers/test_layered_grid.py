"""LayeredGrid works without TerrainGrid, which only adds queries."""

from __future__ import annotations

import copy
import dataclasses
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.terrain.layers.layered_grid import LayeredGrid
from guara_perception.terrain.questions.best_foothold import best_foothold
from guara_perception.terrain.questions.foothold import check_foothold, explain
from guara_perception.terrain.questions.normal import normal_at
from guara_perception.terrain.questions.obstacles import obstacles
from guara_perception.terrain.questions.path import check_path, check_polygon
from guara_perception.terrain.questions.points import coarser
from guara_perception.terrain.questions.save import save_terrain


@pytest.fixture(scope="module")
def terrain() -> gp.TerrainGrid:
    """Ground of 60 x 80 cells with a box, a hole and an unobserved area."""
    heights = np.zeros((60, 80))
    heights[20:30, 30:40] = 0.02
    heights[45:50, 10:14] = -0.03
    heights[5, 70] = np.nan
    return gp.assess_terrain(heights, 0.005, origin=(0.5, -0.15))


@pytest.fixture(scope="module")
def bare(terrain: gp.TerrainGrid) -> LayeredGrid:
    """The same ground without queries."""
    return LayeredGrid(**{entry.name: getattr(terrain, entry.name) for entry in dataclasses.fields(terrain)})


@pytest.mark.slow
def test_queries_ask_only_the_layers(terrain: gp.TerrainGrid, bare: LayeredGrid) -> None:
    """Every query of the bare layers by its module gives the result of TerrainGrid's method."""
    assert not isinstance(bare, gp.TerrainGrid)
    x, y = (v.ravel() for v in np.meshgrid(np.linspace(0.48, 0.92, 23), np.linspace(-0.17, 0.17, 19)))
    np.testing.assert_array_equal(normal_at(bare, x, y), terrain.normal_at(x, y))
    asked, reported = check_foothold(bare, x, y), terrain.check_foothold(x, y)
    assert list(asked) == list(reported) and any(asked) and not all(asked)
    assert [explain(bare, *point) for point in zip(x, y, strict=True)] == [
        terrain.explain(*point) for point in zip(x, y, strict=True)
    ]
    best, same = best_foothold(bare, 0.62, 0.0, 0.1), terrain.best_foothold(0.62, 0.0, 0.1)
    assert best is not None and same is not None
    assert (best.position.tolist(), best.value) == (same.position.tolist(), same.value)
    path = [[0.55, 0.0, 0.0], [0.6, 0.0, 0.06], [0.85, 0.0, 0.06]]
    assert check_path(bare, path, 0.02) == terrain.check_path(path, 0.02)
    square = [[0.55, -0.05], [0.6, -0.05], [0.6, 0.0], [0.55, 0.0]]
    assert check_polygon(bare, square) == terrain.check_polygon(square)
    assert [o.outline.tolist() for o in obstacles(bare)] == [o.outline.tolist() for o in terrain.obstacles()] != []


def test_the_file_of_the_bare_layers_is_that_of_the_terrain(
    terrain: gp.TerrainGrid, bare: LayeredGrid, tmp_path: Path
) -> None:
    """Saved without queries, it is loaded with them."""
    save_terrain(bare, tmp_path / "bare.npz")
    terrain.save(tmp_path / "terrain.npz")
    loaded = gp.load_terrain(tmp_path / "bare.npz")
    assert type(loaded) is gp.TerrainGrid
    with np.load(tmp_path / "bare.npz") as one, np.load(tmp_path / "terrain.npz") as other:
        assert {n: one[n].tobytes() for n in one.files} == {n: other[n].tobytes() for n in other.files}


@pytest.mark.parametrize("which", ["terrain", "bare"])
def test_what_is_made_of_a_grid_is_of_its_kind(which: str, request: pytest.FixtureRequest) -> None:
    """Coarser, changed, pickled and copied grids keep their class."""
    grid: LayeredGrid = request.getfixturevalue(which)
    restored = pickle.loads(pickle.dumps(grid))
    for other in (coarser(grid, 2), dataclasses.replace(grid, step=3), restored, copy.deepcopy(grid), copy.copy(grid)):
        assert type(other) is type(grid)
        assert not other.hazard.flags.writeable
    for name in ("geometry", "frame", "stamp", "step", "extent", "metadata"):
        assert getattr(restored, name) == getattr(grid, name)
    assert dict(restored.pictures) == {}


def test_nothing_can_be_set_or_added(terrain: gp.TerrainGrid, bare: LayeredGrid) -> None:
    """No field, layer or new name can be set or deleted, and there is no `__dict__`."""
    for grid, name in ((bare, "step"), *((terrain, name) for name in ("step", "layers", "elevation", "remark"))):
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(grid, name, 1)
        with pytest.raises(dataclasses.FrozenInstanceError):
            delattr(grid, name)
        assert not hasattr(grid, "__dict__")


def test_a_missing_name_is_reported_with_the_class(terrain: gp.TerrainGrid, bare: LayeredGrid) -> None:
    """The message contains the name, and bare layers have no queries."""
    with pytest.raises(AttributeError, match="^TerrainGrid has no attribute 'slop'; layers: elevation, variance"):
        terrain.slop  # noqa: B018
    with pytest.raises(AttributeError, match="^LayeredGrid has no attribute 'best_foothold'; layers: elevation"):
        bare.best_foothold  # noqa: B018


@pytest.mark.slow
def test_questions_are_loaded_without_the_terrain_grid() -> None:
    """In a fresh process, the modules of all queries load without TerrainGrid."""
    names = ["best_foothold", "foothold", "normal", "obstacles", "path", "points", "save"]
    code = "; ".join(f"import guara_perception.terrain.questions.{name}" for name in names)
    code += "; import sys; print('guara_perception.terrain.grid' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
