"""`gp.open_recording`: a walk as scans, grids, stance pauses and calibration."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.app.files.convert import convert
from guara_perception.app.messages import terrain_to_message
from transport import PausePhase, StanceMessage, StancePause
from transport.recording import RecordingWriter


@pytest.fixture
def walk(tmp_path: Path, paper_terrain: gp.TerrainGrid, calibration_file: Path) -> Path:
    """Two grids and one announced pause."""
    path = tmp_path / "walk.mcap"
    with RecordingWriter(path, calibration=calibration_file.read_bytes()) as writer:
        for sequence in (1, 2):
            writer.add_terrain(terrain_to_message(paper_terrain, robot="guara", sequence=sequence))
        stance = StanceMessage(joint_positions={"a": 0.5}, support_feet=("lf",))
        writer.add_stance_pause(
            StancePause(robot="guara", step=4, phase=PausePhase.BEGIN, stamp=1, stance=stance, time_available=9.0)
        )
    return path


def test_grids_stances_and_calibration_come_back(walk: Path, paper_terrain: gp.TerrainGrid, calibration):
    """Iterating gives TerrainGrids equal to those written."""
    with gp.open_recording(walk) as recording:
        grids = list(recording)
        assert len(grids) == 2 and all(isinstance(grid, gp.TerrainGrid) for grid in grids)
        assert np.array_equal(grids[0].elevation, paper_terrain.elevation, equal_nan=True)
        assert list(recording.grids("map")) == []
        assert [pause.step for pause in recording.stances()] == [4]
        assert recording.calibration is not None and len(recording.calibration.stripes) == len(calibration.stripes)
        assert recording.scans == ()


@pytest.mark.slow
def test_scans_can_be_processed_again(data: Path, tmp_path: Path, calibration, paper_terrain: gp.TerrainGrid):
    """A recorded scan gives the grid that its folder gives."""
    with gp.open_recording(convert(data / "scans" / "paper", tmp_path / "paper.mcap")) as recording:
        (scan,) = recording.scans
        terrain = gp.process_scan(scan, calibration, "guara", pictures=False)
        assert recording.calibration is None
    assert np.array_equal(terrain.elevation, paper_terrain.elevation, equal_nan=True)


def test_wrong_extent_and_files_are_refused(walk: Path, tmp_path: Path):
    """One error each that says what is allowed or what is wrong."""
    with gp.open_recording(walk) as recording, pytest.raises(gp.InvalidInput, match="allowed: footprint, map"):
        list(recording.grids("world"))
    with pytest.raises(gp.MissingFile, match="no such file"):
        gp.open_recording(tmp_path / "none.mcap")
    (tmp_path / "text.mcap").write_text("not a recording")
    with pytest.raises(gp.FileFormatError, match="text.mcap"):
        gp.open_recording(tmp_path / "text.mcap")
