"""TerrainGrid: axis order, look-ups, conversions, immutability, file."""

from __future__ import annotations

import copy
import dataclasses
import json
import pickle
from pathlib import Path

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.terrain.layers.geometry import GridGeometry
from guara_perception.terrain.layers.hazard import MEANING, Hazard, cells_by_flag, names
from guara_perception.terrain.layers.record import ScanRecord


@pytest.fixture
def terrain() -> gp.TerrainGrid:
    """Flat known ground of 40 x 60 cells with its corner at (0.5, -0.1), a hole, and two cells of other heights."""
    heights = np.zeros((40, 60))
    heights[10, 20] = np.nan
    heights[30, 5] = 0.001
    return gp.assess_terrain(heights, 0.005, origin=(0.5, -0.1))


def test_flag_values_never_change() -> None:
    """Values are part of messages and files."""
    expected = {
        "DROPOUT": 1,
        "OCCLUDED": 2,
        "UNSCANNED": 4,
        "OUT_OF_RANGE": 8,
        "AMBIGUOUS": 16,
        "SELF": 32,
        "SOFT": 64,
        "STEEP": 256,
        "STEP": 512,
        "DROP": 1024,
        "ROUGH": 2048,
        "EDGE": 4096,
        "UNCERTAIN": 8192,
        "CONFLICT": 16384,
        "STALE": 32768,
    }
    assert {flag.name: int(flag) for flag in Hazard if flag} == expected
    assert set(MEANING) == {flag for flag in Hazard if flag}
    assert names(Hazard.STALE | Hazard.DROPOUT) == ["DROPOUT", "STALE"]


def test_cells_are_counted_by_flag() -> None:
    """Every flag by name; a cell with several flags counts for each of them."""
    hazard = np.array([[0, 1, 1 | 2], [4096 | 32768, 32768, 32]], np.uint16)
    counts = cells_by_flag(hazard)
    assert list(counts) == [flag.name for flag in MEANING]
    assert {name: n for name, n in counts.items() if n} == {
        "DROPOUT": 2, "OCCLUDED": 1, "SELF": 1, "EDGE": 1, "STALE": 2
    }  # fmt: skip
    assert not any(cells_by_flag(np.zeros((2, 3), np.uint16)).values())


def test_cells_are_half_open_and_found_by_their_corner(terrain: gp.TerrainGrid) -> None:
    """A cell includes its lower corner, not its upper one, in spite of rounding."""
    x, y = 0.5 + 5 * 0.005, -0.1 + 30 * 0.005
    assert terrain.height_at(x, y) == pytest.approx(0.001)
    assert terrain.height_at(x + 0.00499, y + 0.00499) == pytest.approx(0.001)
    assert terrain.height_at(x - 0.0001, y) == 0.0
    assert terrain.height_at(x, y - 0.0001) == 0.0
    assert terrain.height_at(x + 0.005, y) == 0.0


@pytest.mark.parametrize(
    "point", [(0.4999, 0.0), (0.8001, 0.0), (0.6, -0.1001), (0.6, 0.1001), (np.nan, 0), (1e300, 0)]
)
def test_outside_is_unknown_unscanned_and_not_traversable(terrain: gp.TerrainGrid, point: tuple[float, float]) -> None:
    """Off the grid, not finite or very far away: NaN, UNSCANNED, False, and no error."""
    assert np.isnan(terrain.height_at(*point))
    assert terrain.hazard_at(*point) == Hazard.UNSCANNED
    assert terrain.is_traversable(*point) is False
    assert np.isnan(terrain.normal_at(*point)).all()


def test_arrays_and_numbers_are_answered_alike(terrain: gp.TerrainGrid) -> None:
    """Arrays of any shape give arrays of that shape, with the values of single queries."""
    rng = np.random.default_rng(0)
    x, y = rng.uniform(0.45, 0.85, (7, 5)), rng.uniform(-0.15, 0.15, (7, 5))
    heights, flags, safe = terrain.height_at(x, y), terrain.hazard_at(x, y), terrain.is_traversable(x, y)
    assert heights.shape == flags.shape == safe.shape == (7, 5)
    for i in np.ndindex(x.shape):
        np.testing.assert_equal(float(heights[i]), terrain.height_at(x[i], y[i]))
        assert Hazard(int(flags[i])) == terrain.hazard_at(float(x[i]), float(y[i]))
        assert bool(safe[i]) == terrain.is_traversable(float(x[i]), float(y[i]))
    assert isinstance(terrain.height_at(0.6, 0.0), float)
    assert terrain.height_at(0.6, np.zeros(4)).shape == (4,)


def test_positions_that_do_not_fit_together_are_refused(terrain: gp.TerrainGrid) -> None:
    """Three x and two y, or a text, are rejected with one message."""
    for x, y in (([1, 2, 3], [1, 2]), ("here", 0.0)):
        with pytest.raises(gp.InvalidInput, match="numbers or arrays that broadcast to one shape"):
            terrain.height_at(x, y)


def test_occupancy_bytes_are_row_by_row_from_the_corner() -> None:
    """Expected bytes: -1 and 100 for unknown, 0 for perfect ground, data = ravel, x fastest."""
    heights = np.zeros((40, 50))
    heights[0, 3] = np.nan
    heights[39, 0] = np.nan
    terrain = gp.assess_terrain(heights, 0.005)
    data = terrain.to_occupancy(unknown=-1).ravel()
    assert data.dtype == np.int8
    assert np.flatnonzero(data == -1).tolist() == [3, 39 * 50]
    assert data[20 * 50 + 25] == 0
    assert data[0] == 100
    assert terrain.to_occupancy().ravel().tobytes()[3] == 100
    with pytest.raises(gp.InvalidInput, match="unknown is 50, allowed: 100 .* -1"):
        terrain.to_occupancy(unknown=50)


def test_occupancy_is_the_score_in_ninety_ninths() -> None:
    """Free cells are round(99 * (1 - traversability)), so that the lowest score is still below 100."""
    ramp = np.tile(np.arange(60) * 0.005 * np.tan(0.1), (60, 1))
    terrain = gp.assess_terrain(ramp, 0.005)
    score = float(terrain.traversability[30, 30])
    assert terrain.to_occupancy()[30, 30] == round(99 * (1 - score))
    assert 0 < terrain.to_occupancy()[30, 30] < 100


def test_layers_are_there_by_name_and_cannot_be_written(terrain: gp.TerrainGrid) -> None:
    """Attribute and name give the same array; nothing in a grid can be changed."""
    assert terrain.layer("slope") is terrain.slope
    with pytest.raises(gp.InvalidInput, match="layer is 'height', allowed: elevation, variance"):
        terrain.layer("height")
    with pytest.raises(AttributeError, match="no attribute 'slop'; layers: elevation"):
        terrain.slop  # noqa: B018
    with pytest.raises(ValueError, match="read-only"):
        terrain.hazard[0, 0] = 0
    with pytest.raises(dataclasses.FrozenInstanceError):
        terrain.step = 3  # type: ignore[misc]


def test_a_grid_survives_pickling_and_copying(terrain: gp.TerrainGrid) -> None:
    """The copy has the same bytes and is read-only too."""
    for twin in (pickle.loads(pickle.dumps(terrain)), copy.deepcopy(terrain)):
        for name, layer in terrain.layers.items():
            assert twin.layer(name).tobytes() == layer.tobytes()
            assert not twin.layer(name).flags.writeable
        assert twin.metadata == terrain.metadata


def test_wrong_extent_or_geometry_is_refused(terrain: gp.TerrainGrid) -> None:
    """Layers must fit the geometry, and there are two extents."""
    with pytest.raises(gp.InvalidInput, match="extent is 'world', allowed: footprint, map"):
        dataclasses.replace(terrain, extent="world")
    with pytest.raises(gp.InvalidInput, match=r"layers have shape \(40, 60\), but the geometry has \(60, 40\)"):
        dataclasses.replace(terrain, geometry=GridGeometry((0, 0), 0.005, (60, 40)))


@pytest.mark.parametrize("resolution", [0.0, -1.0, np.nan, np.inf, 0.007])
def test_a_resolution_must_divide_the_area(resolution: float) -> None:
    """Zero, negative, NaN, or a value that does not divide the area is rejected."""
    with pytest.raises(gp.InvalidInput, match="resolution"):
        GridGeometry.over((0.5, 0.95), (-0.27, 0.27), resolution)


def test_file_round_trip(terrain: gp.TerrainGrid, tmp_path: Path) -> None:
    """After saving and loading, every layer has the same bytes and every field the same value."""
    full = dataclasses.replace(
        terrain, stamp=12, step=3, extent="map", record=ScanRecord.from_json({**terrain.metadata, "robot": "guara"})
    )
    full.save(tmp_path / "t.npz")
    back = gp.load_terrain(tmp_path / "t.npz")
    for name, layer in full.layers.items():
        assert back.layer(name).tobytes() == layer.tobytes()
    assert (back.stamp, back.step, back.extent, back.frame) == (12, 3, "map", "base_footprint")
    assert back.geometry == full.geometry
    assert back.metadata == full.metadata
    with np.load(tmp_path / "t.npz") as content:
        assert content["origin"].tolist() == [0.5, -0.1]
        assert json.loads(str(content["metadata"]))["extent"] == "map"


def test_files_that_are_no_terrain_are_refused(terrain: gp.TerrainGrid, tmp_path: Path) -> None:
    """Missing, empty, truncated, other, incomplete and unsafe files: one line that names the file."""
    path = tmp_path / "t.npz"
    with pytest.raises(gp.MissingFile, match="t.npz: no such file"):
        gp.load_terrain(path)
    path.write_bytes(b"")
    with pytest.raises(gp.FileFormatError, match="t.npz: not a terrain file"):
        gp.load_terrain(path)
    terrain.save(path)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(gp.FileFormatError, match="t.npz"):
        gp.load_terrain(path)
    path.write_bytes(whole)
    with np.load(path) as content:
        data = {name: content[name] for name in content.files}
    np.savez(path, **{name: array for name, array in data.items() if name != "hazard"})
    with pytest.raises(gp.FileFormatError, match="missing arrays: hazard"):
        gp.load_terrain(path)
    unsafe = {**data, "hazard": np.zeros_like(data["hazard"])}
    np.savez(path, **unsafe)
    with pytest.raises(gp.FileFormatError, match="NaN without an unknown flag"):
        gp.load_terrain(path)
    with pytest.raises(gp.MissingFile):
        terrain.save(tmp_path / "no" / "t.npz")
