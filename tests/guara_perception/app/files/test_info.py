"""`guara info` describes every kind of file that this project writes."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import guara_perception as gp
from guara_perception.app.files.convert import convert


@pytest.fixture
def recording(data: Path, tmp_path: Path) -> Path:
    """Recording of the paper scan."""
    return convert(data / "scans" / "paper", tmp_path / "paper.mcap")


def reported(guara, path: Path) -> dict[str, object]:
    """Output of `--json`."""
    said = guara("info", path, "--json")
    assert said.code == 0, said.err
    return json.loads(said.out)


@pytest.mark.slow
def test_each_kind_is_known(guara, data: Path, root: Path, terrain_file: Path, calibration_file: Path, recording: Path):
    """Grid, recording, calibration, scan, session and robot, each with its own values."""
    grid = reported(guara, terrain_file)
    assert grid["kind"] == "grid" and grid["cells"] == [90, 108] and 0.8 < grid["known"] < 1
    assert reported(guara, recording)["scans"] == [{"step": 0, "mode": "coarse", "stripes": 35}]
    calibration = reported(guara, calibration_file)
    assert calibration["kind"] == "calibration" and calibration["picture_size"] == [640, 512]
    scan = reported(guara, data / "scans" / "paper")
    assert scan["kind"] == "scan" and scan["laser_off_frames"] == 1 and scan["carries_calibration"] is False
    session = reported(guara, data / "calibration")
    assert session["kind"] == "calibration session" and session["plates"] == [0.0, 0.04, 0.08]
    assert reported(guara, root / "robots" / "guara")["legs"] == ["lf", "rf", "lh", "rh"]


def test_words_for_people(guara, terrain_file: Path, data: Path):
    """One line per value, with readable names and values."""
    said = guara("info", terrain_file)
    assert said.code == 0 and "kind:                grid\n" in said.out and "hazards:             DROPOUT " in said.out
    said = guara("info", data / "scans" / "paper")
    assert "carries calibration: no\n" in said.out and "calibration hash:    none\n" in said.out


def test_long_lists_are_cut_for_people(guara, monkeypatch: pytest.MonkeyPatch):
    """Of many scans, the first and the last are shown, and their number."""
    scans = [{"step": step, "mode": "coarse"} for step in range(41)]
    monkeypatch.setattr("guara_perception.app.files.info.describe_file", lambda _: {"scans": scans})
    line = "step 0, mode coarse; step 1, mode coarse; step 2, mode coarse; ...; step 40, mode coarse (41 in all)"
    assert line in guara("info", "walk.mcap").out
    assert json.loads(guara("info", "walk.mcap", "--json").out) == {"scans": scans}


def test_what_is_not_ours_is_refused(guara, tmp_path: Path):
    """Exit 2 with the known kinds; a missing path is reported as missing."""
    (tmp_path / "notes.txt").write_text("hello")
    said = guara("info", tmp_path / "notes.txt")
    assert said.code == 2 and "notes.txt: unknown kind of file; it must be a grid (.npz)" in said.err
    said = guara("info", tmp_path / "none.npz")
    assert said.code == 2 and "none.npz: no such file or folder" in said.err
    said = guara("info", tmp_path)
    assert said.code == 2 and "unknown kind of file" in said.err


def test_a_broken_robot_folder_is_refused(guara, tmp_path: Path):
    """Refused in one line."""
    (tmp_path / "robot.toml").write_text("name = 3")
    said = guara("info", tmp_path)
    assert said.code == 2 and said.err.count("\n") == 1 and str(tmp_path) in said.err


@pytest.mark.slow
def test_json_of_process_is_that_of_info(guara, data: Path, calibration_file: Path, tmp_path: Path):
    """`guara process --json` prints what `guara info --json` prints for its file."""
    said = guara("process", data / "scans" / "paper", "-c", calibration_file, "-o", tmp_path / "t.npz", "--json")
    printed = json.loads(said.out)
    assert printed.pop("file") == str(tmp_path / "t.npz")
    found = reported(guara, tmp_path / "t.npz")
    assert found.pop("kind") == "grid" and found == printed
    assert gp.load_terrain(tmp_path / "t.npz").step == printed["step"]
