"""Scans of a recording whose grids the node withdrew are distinguished from the others."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.app.files.open_scan import open_scans
from guara_perception.app.messages import stance_to_message, terrain_to_message
from transport import Health, TerrainMessage
from transport.recording import FrameRecord, RecordingWriter, ScanRecord

WITHDRAWN = {"withdrawn": True, "provisional": False}


@pytest.fixture
def grid(paper_terrain: gp.TerrainGrid) -> TerrainMessage:
    return terrain_to_message(dataclasses.replace(paper_terrain, pictures={}), robot="guara", sequence=1)


def _said(grid: TerrainMessage, step: int, stamp: int, reported: dict, extent: str = "footprint") -> TerrainMessage:
    metadata = json.dumps({**json.loads(grid.metadata), "epoch": "walk", **reported})
    health = Health.ERROR if reported.get("withdrawn") else Health.OK
    if reported.get("withdrawn"):
        nothing = {"elevation": np.full(grid.shape, np.nan, np.float32)}
        nothing["traversability"] = np.zeros(grid.shape, np.float32)
        grid = dataclasses.replace(grid, layers={**grid.layers, **nothing})
    return dataclasses.replace(
        grid, step=step, stamp=stamp, extent=extent, metadata=metadata, health=health, health_reasons=("it moved",)
    )


def _record(path: Path, scan: gp.Scan, *entries: tuple[int, int] | TerrainMessage) -> list[str]:
    """Record scans (step, stamp) and grids in this order; return why each scan was withdrawn."""
    with RecordingWriter(path) as writer:
        for entry in entries:
            if isinstance(entry, TerrainMessage):
                writer.add_terrain(entry)
                continue
            step, stamp = entry
            stance = stance_to_message(scan.stance)
            writer.begin_scan(ScanRecord(robot="guara", mode="coarse", stamp=stamp, step=step, stance=stance))
            writer.add_stripe(0, 0.1, FrameRecord(pixels=np.zeros((4, 4), np.uint8), stamp=stamp), None)
            writer.end_scan(stamp=stamp)
    return [found.withdrawn for found in open_scans(path)]


def test_a_withdrawn_grid_marks_the_scans_of_its_pause(grid: TerrainMessage, paper_scan: gp.Scan, tmp_path: Path):
    """Both scans of pause 2, in which the robot moved, and no scan of the pauses before and after."""
    entries = ((1, 100), (2, 200), (2, 250), _said(grid, 2, 300, WITHDRAWN), (3, 400))
    assert _record(tmp_path / "r.mcap", paper_scan, *entries) == ["", "it moved", "it moved", ""]


def test_a_map_that_was_confirmed_does_not_excuse_a_scan(grid: TerrainMessage, paper_scan: gp.Scan, tmp_path: Path):
    """The map may contain an earlier scan of the pause, before the mirror slipped; the safer case is assumed."""
    entries = ((2, 200), _said(grid, 2, 200, {"provisional": False}, "map"), (2, 250), _said(grid, 2, 300, WITHDRAWN))
    assert _record(tmp_path / "r.mcap", paper_scan, *entries) == ["it moved", "it moved"]


def test_a_gait_that_counts_from_zero_again_has_the_same_step_twice(
    grid: TerrainMessage, paper_scan: gp.Scan, tmp_path: Path
):
    """The scan before the withdrawal is marked; after the clock was set back, every scan of the step is."""
    entries = ((2, 200), (1, 500), (2, 600), _said(grid, 2, 700, WITHDRAWN))
    assert _record(tmp_path / "r.mcap", paper_scan, *entries) == ["", "", "it moved"]
    entries = ((2, 200), (1, 500), (2, 600), _said(grid, 2, 100, WITHDRAWN))
    assert _record(tmp_path / "b.mcap", paper_scan, *entries) == ["it moved", "", "it moved"]


def test_a_scan_belongs_to_the_walk_of_its_grid(grid: TerrainMessage, paper_scan: gp.Scan, tmp_path: Path):
    """All scans of a pause belong to the walk of its grid; a pause without a grid belongs to no known walk."""
    path, other = tmp_path / "r.mcap", {"epoch": "other"}
    grids = _said(grid, 2, 300, {}), _said(grid, 2, 500, other)
    scans = (1, 100), (2, 200), (2, 250), grids[0], (2, 350), (1, 370), (2, 400), grids[1], (3, 600)
    _record(path, paper_scan, *scans)
    assert [scan.epoch for scan in open_scans(path)] == ["", "walk", "walk", "walk", "", "other", ""]


def test_a_scan_that_ended_before_its_first_stripe_is_left_out(paper_scan: gp.Scan, tmp_path: Path):
    """The other scans of the recording open as usual."""
    path, stance = tmp_path / "r.mcap", stance_to_message(paper_scan.stance)
    with RecordingWriter(path) as writer:
        for step, frames in ((1, 0), (2, 1)):
            writer.begin_scan(ScanRecord(robot="guara", mode="coarse", stamp=step, step=step, stance=stance))
            # Fired, but its frame was lost.
            writer.add_stripe(0, 0.1, None, None, stamp=step)
            for _ in range(frames):
                writer.add_stripe(2, 0.1, FrameRecord(pixels=np.zeros((4, 4), np.uint8), stamp=step), None)
            writer.end_scan(stamp=step)
    assert [scan.step for scan in open_scans(path)] == [2]
    assert gp.open_scan(path).step == 2
