"""`gp.open_recording`: scans, grids, stance pauses and calibration of a walk."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.app.files.convert import convert
from guara_perception.app.messages import stance_to_message, terrain_to_message
from transport import PausePhase, StanceMessage, StancePause
from transport.recording import FrameRecord, RecordingWriter, ScanRecord


@pytest.fixture
def walk(tmp_path: Path, paper_terrain: gp.TerrainGrid, calibration_file: Path) -> Path:
    """Recording with two grids and one announced pause."""
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
    """Iterating yields TerrainGrids equal to those written."""
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
    """A recorded scan gives the same grid as its folder."""
    with gp.open_recording(convert(data / "scans" / "paper", tmp_path / "paper.mcap")) as recording:
        (scan,) = recording.scans
        terrain = gp.process_scan(scan, calibration, "guara", pictures=False)
        assert recording.calibration is None
    assert np.array_equal(terrain.elevation, paper_terrain.elevation, equal_nan=True)


@pytest.mark.slow
def test_scans_of_a_node_with_a_name_of_its_own_can_be_processed(
    calibration_file: Path, tmp_path: Path, paper_scan: gp.Scan
) -> None:
    """The robot of a scan is that of its calibration, not the instance name "lobo"."""
    calibration = gp.load_calibration(calibration_file)
    for number, hash_text, robot in ((0, calibration.hash, "guara"), (1, "0" * 16, "lobo")):
        path = tmp_path / f"{number}.mcap"
        with RecordingWriter(path, robot="lobo", calibration=calibration_file.read_bytes()) as writer:
            stance = stance_to_message(paper_scan.stance)
            record = ScanRecord(robot="lobo", mode="coarse", stamp=1, step=0, stance=stance, calibration_hash=hash_text)
            writer.begin_scan(record)
            for stripe in paper_scan.stripes[:2]:
                frame = FrameRecord(pixels=paper_scan.read_frame(stripe.on))
                writer.add_stripe(stripe.index, stripe.mirror_angle, frame)
            writer.end_scan()
        assert gp.open_scan(path).robot == robot
        if robot == "guara":
            assert gp.process_scan(path, pictures=False).metadata["robot"] == "guara"


def test_wrong_extent_and_files_are_refused(walk: Path, tmp_path: Path):
    """Each error states what is wrong or what is allowed."""
    with gp.open_recording(walk) as recording, pytest.raises(gp.InvalidInput, match="allowed: footprint, map"):
        list(recording.grids("world"))
    with pytest.raises(gp.MissingFile, match="no such file"):
        gp.open_recording(tmp_path / "none.mcap")
    (tmp_path / "text.mcap").write_text("not a recording")
    with pytest.raises(gp.FileFormatError, match="text.mcap"):
        gp.open_recording(tmp_path / "text.mcap")
