"""Export by `guara convert`: trimesh, pypcd4 and csv read what the grid contains; unknown cells give no points."""

from __future__ import annotations

import csv
import importlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.app.files.export import export_terrain
from guara_perception.app.messages import terrain_to_message
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK
from transport.recording import RecordingWriter


def point_cloud() -> Any:
    """Import `PointCloud` of pypcd4 only when needed, like trimesh, since every worker collects this file."""
    return importlib.import_module("pypcd4").PointCloud


@pytest.mark.slow
def test_ply_opens_in_trimesh(paper_terrain: gp.TerrainGrid, tmp_path: Path):
    """A vertex per known cell, at its centre and height, in the colour of its hazard."""
    count = export_terrain(paper_terrain, tmp_path / "t.ply")
    trimesh = importlib.import_module("trimesh")
    cloud = trimesh.load(tmp_path / "t.ply")
    assert len(cloud.vertices) == count == len(paper_terrain.points())
    assert np.allclose(cloud.vertices, paper_terrain.points(), atol=1e-6)
    assert len(np.unique(np.asarray(cloud.colors), axis=0)) > 3


@pytest.mark.slow
def test_pcd_opens_in_pypcd4(paper_terrain: gp.TerrainGrid, tmp_path: Path):
    """Points, sigma and flags are those of the grid."""
    export_terrain(paper_terrain, tmp_path / "t.pcd")
    cloud = point_cloud().from_path(tmp_path / "t.pcd")
    assert cloud.fields == ("x", "y", "z", "sigma", "hazard", "rgb")
    values = cloud.pc_data
    assert np.allclose(np.column_stack([values[n] for n in "xyz"]), paper_terrain.points(), atol=1e-6)
    assert np.array_equal(values["hazard"], paper_terrain.hazard[(paper_terrain.hazard & UNKNOWN_MASK) == 0])
    assert (values["hazard"] & UNKNOWN_MASK == 0).all() and (values["sigma"] > 0).all()


@pytest.mark.slow
def test_csv_has_every_cell_and_the_cause_of_the_unknown(paper_terrain: gp.TerrainGrid, tmp_path: Path):
    """Unknown cells have an empty height and a named cause; known ones have their height to a micrometre."""
    count = export_terrain(paper_terrain, tmp_path / "t.csv")
    with (tmp_path / "t.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == count == paper_terrain.hazard.size
    elevation = np.array([float(row["elevation"] or "nan") for row in rows]).reshape(paper_terrain.shape)
    assert np.allclose(elevation, paper_terrain.elevation, atol=1e-6, equal_nan=True)
    unknown = [row for row in rows if row["elevation"] == ""]
    causes = {"DROPOUT", "OCCLUDED", "UNSCANNED", "OUT_OF_RANGE", "AMBIGUOUS", "SELF"}
    assert unknown and all(causes & set(row["hazard"].split("|")) and row["traversability"] == "0" for row in unknown)


def test_a_grid_without_points_is_a_file_without_points(make_unknown: gp.TerrainGrid, tmp_path: Path):
    """A grid without known cells gives a file without points, which the readers accept."""
    assert export_terrain(make_unknown, tmp_path / "t.ply") == 0
    assert export_terrain(make_unknown, tmp_path / "t.pcd") == 0
    assert point_cloud().from_path(tmp_path / "t.pcd").points == 0


@pytest.fixture
def make_unknown() -> gp.TerrainGrid:
    """Make every cell of a grid unknown."""
    return gp.assess_terrain(np.full((8, 9), np.nan), 0.005)


def test_other_endings_are_refused(paper_terrain: gp.TerrainGrid, tmp_path: Path, guara, terrain_file: Path):
    """Exit 2 with the allowed endings; saving a grid under such a name is refused too, with the remedy."""
    said = guara("convert", terrain_file, tmp_path / "t.xyz")
    assert said.code == 2 and "t.xyz: it must end in .ply, .pcd, .csv" in said.err
    with pytest.raises(gp.InvalidInput, match=r"t.csv: a grid is saved as .npz; `guara convert` writes .ply"):
        paper_terrain.save(tmp_path / "t.csv")
    assert list(tmp_path.iterdir()) == []


def test_command_exports_a_grid_of_a_recording(guara, paper_terrain: gp.TerrainGrid, tmp_path: Path):
    """The last grid, or the one selected by step; an unknown step is refused with the list of steps."""
    with RecordingWriter(tmp_path / "w.mcap") as writer:
        for sequence in (1, 2):
            writer.add_terrain(terrain_to_message(paper_terrain, robot="guara", sequence=sequence))
    assert guara("convert", tmp_path / "w.mcap", tmp_path / "t.ply").code == 0
    said = guara("convert", tmp_path / "w.mcap", "--step", "9", tmp_path / "u.ply")
    assert said.code == 2 and "has no grid of step 9; allowed: 0" in said.err
    said = guara("convert", tmp_path / "w.mcap", "--extent", "map", tmp_path / "u.ply")
    assert said.code == 2 and "contains no map grid; `guara replay` makes grids" in said.err


def test_command_repairs_a_recording(guara, paper_terrain: gp.TerrainGrid, tmp_path: Path):
    """From .mcap to .mcap, all intact data are copied, under both spellings; options for grids are refused."""
    cut, whole = tmp_path / "cut.mcap", tmp_path / "whole.mcap"
    with RecordingWriter(tmp_path / "w.mcap") as writer:
        writer.add_terrain(terrain_to_message(paper_terrain, robot="guara", sequence=1))
    cut.write_bytes((tmp_path / "w.mcap").read_bytes()[:-200])
    said = guara("convert", cut, whole)
    assert said.code == 0 and "messages" in said.out and guara("info", whole).code == 0
    assert guara("recover", cut).code == 0 and (tmp_path / "cut-recovered.mcap").read_bytes() == whole.read_bytes()
    said = guara("convert", tmp_path / "none.mcap", tmp_path / "x.mcap")
    assert said.code == 2 and "none.mcap: no such file" in said.err
    for option in (("--step", "1"), ("--extent", "map")):
        said = guara("convert", cut, tmp_path / "y.mcap", *option)
        assert said.code == 2 and f"leave {option[0]} out" in said.err


def test_the_earlier_spelling_exports_the_same(guara, terrain_file: Path, tmp_path: Path):
    """`guara export GRID -o FILE` writes the same bytes as `guara convert GRID FILE`."""
    assert guara("export", terrain_file, "-o", tmp_path / "a.csv").code == 0
    assert guara("convert", terrain_file, tmp_path / "b.csv").code == 0
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()
