"""Swaying robot, gait and node in separate processes, with and without a joint stream."""

from __future__ import annotations

import json
import signal
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.app.files.convert import convert
from guara_perception.app.files.open_scan import open_scans
from guara_perception.app.messages import message_to_terrain
from guara_perception.app.node.simulated import DEMO_WORLD
from guara_perception.scanning.process import run_scan
from guara_perception.simulation.sway import Sway
from guara_perception.simulation.world import load_world
from kinematics import RobotModel
from testbed.swaying_node import standing
from tests.forked import ForkedProcess
from transport.recording import open_recording

pytestmark = pytest.mark.heavy
PATIENCE = 180.0
SWAY = Sway(float(np.radians(0.5)), 0.005, 1.0)
WRONG_M, P95_M = 0.005, 0.002
# Number of cells of 9,720; a still scan with images of this size knows some 9,300.
LEAST_KNOWN = 7500


@pytest.fixture
def node(free_endpoint: str, tmp_path: Path) -> Iterator[ForkedProcess]:
    arguments = ["node", str(tmp_path), free_endpoint, "--mode", "coarse", "--jpeg", "0"]
    process = ForkedProcess("-m", "testbed.swaying_node", *arguments, "--record", str(tmp_path / "w.mcap"))
    yield process
    process.kill()


def walked(
    endpoint: str, rate: float, pauses: int, known: int = -1
) -> tuple[dict[int, float], dict[str, list[gp.TerrainGrid]]]:
    """Times of BEGIN by step, and the grids of both extents received by a planner."""
    heard: dict[str, list[gp.TerrainGrid]] = {"footprint": [], "map": []}
    with gp.TerrainClient(endpoint, timeout=PATIENCE) as client:
        for extent, grids in heard.items():
            client.on_terrain(grids.append, extent)
        numbers = ["--rate", str(rate), "--pauses", str(pauses), "--known", str(known)]
        gait = ForkedProcess("-m", "testbed.swaying_node", "gait", endpoint, *numbers)
        printed, errors = gait.communicate(timeout=PATIENCE)
        assert gait.returncode == 0, errors
    return {said["step"]: said["begun"] for said in map(json.loads, printed.splitlines())}, heard


def errors_of(grid: gp.TerrainGrid, robot: RobotModel, begun: float) -> np.ndarray:
    """Height errors [m] relative to the feet at BEGIN, without the tilt caused by its joints and IMU."""
    assert grid.record.stance is not None
    pose = robot.stance_pose(grid.record.stance)
    to_world = standing(robot) @ SWAY.at(begun) @ np.linalg.inv(pose.transform_base_to_footprint)
    x, y = np.meshgrid(*grid.geometry.centres())
    points = np.stack((x, y, grid.elevation), axis=-1) @ to_world[:3, :3].T + to_world[:3, 3]
    return points[..., 2] - load_world(DEMO_WORLD).height(points[..., 0], points[..., 1])


def wrong(grid: gp.TerrainGrid, error: np.ndarray) -> int:
    return int(np.count_nonzero((grid.hazard == 0) & (np.abs(error) > WRONG_M)))


def test_a_swaying_robot_with_a_stream_is_scanned_and_its_recording_gives_the_same(
    node: ForkedProcess, free_endpoint: str, robot: RobotModel, tmp_path: Path
) -> None:
    """0.5 degrees, 5 mm, 1 Hz, 200 samples a second: confirmed, correct, most cells known; also from the recording."""
    begun, heard = walked(free_endpoint, 200.0, 3, LEAST_KNOWN)
    confirmed = [grid for grid in heard["footprint"] if not grid.is_provisional and np.isfinite(grid.elevation).any()]
    # On a busy machine samples may arrive too late for a scan, which then has no stream and is withdrawn, or for some
    # stripes, which are left out.
    assert max((np.isfinite(grid.elevation).sum() for grid in confirmed), default=0) >= LEAST_KNOWN
    for grid in confirmed:
        error = errors_of(grid, robot, begun[grid.step])
        assert wrong(grid, error) == 0 and np.nanpercentile(np.abs(error), 95) < P95_M
    for fused in heard["map"]:
        assert np.isfinite(fused.elevation).any()
    node.send_signal(signal.SIGINT)
    node.wait(PATIENCE)
    calibration = gp.load_calibration(tmp_path / "calibration.json")
    with open_recording(tmp_path / "w.mcap") as recording:
        live = {message.step: message_to_terrain(message) for message in recording.terrains()}
    scans = [scan for scan in open_scans(tmp_path / "w.mcap") if not scan.withdrawn]
    assert {grid.step for grid in confirmed} <= {scan.step for scan in scans}
    compared = 0
    for scan in scans:
        again, then = run_scan(scan, calibration, robot).finish(), live[scan.step]
        # Samples that came too late for the live scan are in the recording.
        if again.record.frames_bad == then.record.frames_bad:
            np.testing.assert_array_equal(again.elevation, then.elevation)
            np.testing.assert_array_equal(again.hazard, then.hazard)
            compared += 1
    assert compared
    with pytest.raises(gp.InvalidInput, match="which a scan folder cannot contain"):
        convert(tmp_path / "w.mcap", tmp_path / "folder", step=0)


def test_without_a_stream_a_swaying_robot_is_refused(
    node: ForkedProcess, free_endpoint: str, robot: RobotModel
) -> None:
    """Moved stripes are left out with their cause, and the readings of END withdraw the rest."""
    begun, heard = walked(free_endpoint, 0.0, 2)
    grids = heard["footprint"]
    assert {grid.step for grid in grids} == {0, 1}
    for grid in grids:
        assert wrong(grid, errors_of(grid, robot, begun[grid.step])) == 0
        assert grid.is_provisional or not np.isfinite(grid.elevation).any()
    reasons = [reason for grid in grids for reason in grid.record.health.reasons]
    assert any("camera moved" in reason and "stream its joint positions" in reason for reason in reasons)
    assert any("withdrawn: the camera moved by" in reason for reason in reasons)
