"""`guara run` scans with the firmware on its chip and a GigE Vision camera that it triggers: every stripe is proved."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.app.node.simulated import DEMO_WORLD, SimulatedGait
from guara_perception.simulation.walk import WalkPause, simulate_walk
from guara_perception.simulation.world import World, load_world
from kinematics import RobotModel
from testbed.chip import Chip
from tests.gige import alone_with_aravis
from transport import open_client
from transport.stance_link import StancePublisher

pytestmark = [pytest.mark.chip, pytest.mark.slow]
# Seconds for anything that must happen at all, on a machine busy with other things.
PATIENCE = 240.0


@contextmanager
def node(folder: Path, endpoint: str, *arguments: str) -> Iterator[subprocess.Popen[str]]:
    """`guara run` over chip and camera, in a process of its own; says when it listens."""
    program = [
        sys.executable,
        "-X",
        "faulthandler",
        "-m",
        "testbed.triggered_node",
        str(folder),
        "--listen",
        endpoint,
        *arguments,
    ]
    process = subprocess.Popen(program, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        said = process.stdout.readline()
        assert "listening on" in said, process.communicate(timeout=PATIENCE)
        assert "guara-perception" in process.stdout.readline()
        yield process
    finally:
        process.kill()
        process.communicate(timeout=PATIENCE)


def end_of(process: subprocess.Popen[str]) -> tuple[str, str]:
    """Its output until it ended; with a traceback of each thread, if it does not end."""
    try:
        return process.communicate(timeout=PATIENCE)
    except subprocess.TimeoutExpired:
        process.send_signal(signal.SIGABRT)
        return process.communicate(timeout=PATIENCE)


@pytest.mark.parametrize("wired", [True, False])
def test_a_whole_scan_is_triggered_proved_and_published(
    wired: bool, tmp_path: Path, free_endpoint: str, robot: RobotModel, new_chip: Callable[[], Chip]
) -> None:
    """70 of 70 stripes of one channel; by chip time and processor work the grid is out within 0.74 s.

    The grid is that of the ground: heights agree with the world's. Without EXPOSURE_ACTIVE frames are proved by
    their times alone.
    """
    new_chip()  # Skips where the emulator is missing.
    world = load_world(DEMO_WORLD)
    pause = next(simulate_walk(world, robot, cycles=0))
    with alone_with_aravis(), node(tmp_path, free_endpoint, *([] if wired else ["--unwired"])) as process:
        with gp.TerrainClient(free_endpoint, timeout=PATIENCE) as client, open_client(free_endpoint) as session:
            gait = SimulatedGait(StancePublisher(session, robot=robot.name), robot.name)
            gait.begin(pause)
            terrain = client.wait_for_step(pause.step, timeout=PATIENCE)
            assert process.stdout is not None
            scan = json.loads(process.stdout.readline())
            gait.hold(pause)
            gait.end(pause)
        process.send_signal(signal.SIGINT)
        said, complaint = end_of(process)
    assert process.returncode == 0, complaint
    assert said.splitlines()[-1] == "stopped, laser off"
    assert (scan["stripes"], scan["proved"], scan["repeated"]) == (70, 70, 0)
    assert scan["mono"] and scan["counted"] == wired
    # Four frames of dark flashes are in it.
    assert scan["seconds"] <= 0.74
    assert terrain.metadata["health"] == {"level": "ok", "reasons": []}
    assert np.isfinite(terrain.elevation).mean() > 0.9
    assert errors_of(terrain, world, pause, robot) < 0.002


def errors_of(terrain: gp.TerrainGrid, world: World, pause: WalkPause, robot: RobotModel) -> float:
    """Median distance of the known heights from the world's [m]."""
    base_to_footprint = robot.stance_pose(pause.stance).transform_base_to_footprint
    footprint_to_world = pause.transform_base_to_world @ np.linalg.inv(base_to_footprint)
    x, y = np.meshgrid(*terrain.geometry.centres())
    cells = np.stack([x, y, terrain.elevation, np.ones_like(x)], axis=-1)[np.isfinite(terrain.elevation)]
    points = cells @ footprint_to_world.T
    return float(np.median(np.abs(points[:, 2] - world.height(points[:, 0], points[:, 1]))))
