"""A scan with its own calibration needs no other: folders, recordings, and paths in Python."""

from __future__ import annotations

import dataclasses
import shutil
from pathlib import Path

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.app.files.convert import convert
from guara_perception.app.files.open_scan import calibration_for, carried_calibration
from guara_perception.calibration.file import save_calibration


@pytest.fixture
def carrying(paper_copy: Path, calibration_file: Path) -> Path:
    """Scan folder that contains its calibration."""
    shutil.copy(calibration_file, paper_copy / "calibration.json")
    return paper_copy


@pytest.mark.slow
def test_a_folder_and_a_recording_carry_the_same(carrying: Path, calibration_file: Path, tmp_path: Path):
    """Folder -> recording -> folder keeps the calibration, by its content hash."""
    given = gp.load_calibration(calibration_file)
    recording = convert(carrying, tmp_path / "paper.mcap")
    back = convert(recording, tmp_path / "back")
    for path in (carrying, recording, back):
        carried = carried_calibration(path)
        assert carried is not None and carried.hash == given.hash


def test_a_recording_takes_the_calibration_that_is_given(
    guara, paper_copy: Path, calibration_file: Path, tmp_path: Path
):
    """`guara convert -c` stores it in place of the scan's own; that of another robot, and for a grid, is refused."""
    (paper_copy / "calibration.json").write_text("{}")
    recording = tmp_path / "paper.mcap"
    assert guara("convert", paper_copy, recording, "-c", calibration_file).code == 0
    carried = carried_calibration(recording)
    assert carried is not None and carried.hash == gp.load_calibration(calibration_file).hash
    other = tmp_path / "other.json"
    save_calibration(dataclasses.replace(gp.load_calibration(calibration_file), robot="rex"), other)
    said = guara("convert", paper_copy, tmp_path / "b.mcap", "-c", other)
    assert said.code == 2 and "other.json is of robot 'rex', but" in said.err
    said = guara("convert", recording, tmp_path / "a.ply", "-c", calibration_file)
    assert said.code == 2 and "-c is only for a scan that becomes a recording or a folder" in said.err


def test_none_inside_and_none_given_is_refused(data: Path):
    """The message says what is missing and how to give it."""
    assert carried_calibration(data / "scans" / "paper") is None
    with pytest.raises(gp.InvalidInput, match=r"paper has no calibration.json: give the calibration .* \(-c\)"):
        calibration_for(data / "scans" / "paper", None)


def test_the_one_given_wins(carrying: Path, calibration_file: Path, tmp_path: Path):
    """A given calibration is used even if the stored one cannot be read."""
    (carrying / "calibration.json").write_text("{}")
    assert calibration_for(carrying, calibration_file).hash == gp.load_calibration(calibration_file).hash
    with pytest.raises(gp.FileFormatError, match="calibration.json"):
        calibration_for(carrying, None)


@pytest.mark.slow
def test_paths_are_taken_where_objects_are(carrying: Path, calibration_file: Path, paper_terrain: gp.TerrainGrid):
    """Scan, calibration and robot as path or name give the same bytes as the objects."""
    for arguments in ((carrying,), (str(carrying), str(calibration_file), "guara"), (carrying, None, None)):
        terrain = gp.process_scan(*arguments, pictures=False)
        assert np.array_equal(terrain.elevation, paper_terrain.elevation, equal_nan=True)
        assert np.array_equal(terrain.hazard, paper_terrain.hazard)


def test_an_open_scan_needs_its_calibration(paper_scan: gp.Scan):
    """An opened scan has no path in which to look for a calibration."""
    with pytest.raises(gp.InvalidInput, match="give its calibration, which can only be omitted if the scan is a path"):
        gp.process_scan(paper_scan)


@pytest.mark.slow
def test_command_takes_what_the_scan_carries(guara, carrying: Path, tmp_path: Path):
    """`guara process` and `guara replay` without -c."""
    said = guara("process", carrying, "-o", tmp_path / "t.npz")
    assert said.code == 0 and gp.load_terrain(tmp_path / "t.npz").step == 0
    assert guara("replay", carrying, "-o", tmp_path / "grids").code == 0


def test_command_without_any_calibration_is_bad_input(guara, data: Path, tmp_path: Path):
    """Exit 2, one line, nothing written."""
    said = guara("process", data / "scans" / "paper", "-o", tmp_path / "t.npz")
    assert said.code == 2 and "has no calibration.json" in said.err and not (tmp_path / "t.npz").exists()
