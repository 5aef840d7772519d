"""A session folder is started and resumed, and never mixed with another session."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.app.record.session_writer import CROSSES_PICTURE, SessionPlan, SessionWriter, read_plan
from guara_perception.app.targets.drawings import cross_points
from guara_perception.calibration.board import BoardSpec


@pytest.fixture
def plan(robot) -> SessionPlan:
    """Board, crosses and plates as printed by `guara targets`."""
    stance = gp.Stance(robot.posture(robot.config.scan_posture), robot.legs, None)
    return SessionPlan("guara", BoardSpec(9, 7, 0.03), cross_points(robot), (0.0, 0.04), stance)


def test_what_was_taken_is_there_when_it_goes_on(plan: SessionPlan, tmp_path: Path):
    """Existing images are kept and not requested again."""
    first = SessionWriter(tmp_path / "s", plan)
    picture = np.arange(60, dtype=np.uint8).reshape(4, 5, 3)
    for name in ("board_00.png", "board_01.png", CROSSES_PICTURE):
        first.write(name, picture)
    again = SessionWriter(tmp_path / "s", plan)
    assert again.boards == ["board_00.png", "board_01.png"] and again.has(CROSSES_PICTURE)
    assert np.array_equal(again.read("board_01.png"), picture)
    assert not again.has("plate_40")
    moved = dataclasses.replace(plan, plates=(0.0, 0.0405, 0.08, 0.0405))
    assert SessionWriter(tmp_path / "t", moved).plate_names == ["plate_0", "plate_40_5", "plate_80", "plate_40_5-2"]


def test_another_plan_is_refused(plan: SessionPlan, tmp_path: Path):
    """The message names the differences."""
    SessionWriter(tmp_path / "s", plan)
    other = dataclasses.replace(plan, plates=(0.0, 0.05), board=BoardSpec(8, 7, 0.03))
    with pytest.raises(
        gp.InvalidInput, match="was started with other values of board, plates; give the same options or another"
    ):
        SessionWriter(tmp_path / "s", other)


def test_a_part_is_removed_when_it_is_recorded_again(plan: SessionPlan, tmp_path: Path):
    """The plan may differ in this part only, and is read from the folder; nothing is removed before `clear`."""
    writer = SessionWriter(tmp_path / "s", plan)
    for name in ("board_00.png", "board_floor.png", CROSSES_PICTURE):
        writer.write(name, np.zeros((4, 5), np.uint8))
    writer.finish()
    assert read_plan(writer.folder).to_dict() == plan.to_dict()
    other = dataclasses.replace(plan, board=BoardSpec(8, 7, 0.03))
    with pytest.raises(gp.InvalidInput, match="was started with other values of board"):
        SessionWriter(writer.folder, other, ["crosses"])
    again = SessionWriter(writer.folder, other, ["board"])
    assert again.has("session.json") and read_plan(writer.folder).board == plan.board
    again.clear()
    assert sorted(path.name for path in writer.folder.iterdir()) == [CROSSES_PICTURE, "recording.json"]
    assert read_plan(writer.folder).board == other.board
    (writer.folder / "recording.json").write_text(json.dumps({**plan.to_dict(), "stance": {}}))
    with pytest.raises(gp.FileFormatError, match="recording.json: "):
        read_plan(writer.folder)


def test_folders_with_other_things_are_refused(plan: SessionPlan, tmp_path: Path, data: Path):
    """A finished session, a file, and a folder with other contents."""
    with pytest.raises(gp.InvalidInput, match="contains a finished session"):
        SessionWriter(data / "calibration", plan)
    (tmp_path / "file").write_text("x")
    with pytest.raises(gp.InvalidInput, match="is a file; a folder is needed"):
        SessionWriter(tmp_path / "file", plan)
    with pytest.raises(gp.InvalidInput, match="exists and is not a recording"):
        SessionWriter(tmp_path, plan)
