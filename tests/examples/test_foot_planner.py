"""Runs the example planner as a reader would, against a node in another process."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

import guara_perception as gp
from guara_perception.simulation import SimulatedRangefinder, World, specimen
from guara_perception.simulation.walk import simulate_walk
from guara_perception.terrain.map.terrain_map import TerrainMap
from kinematics import LegOdometry, PoseInOdom, load_robot
from tests.ports import free_endpoint

pytestmark = pytest.mark.heavy

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "examples" / "foot_planner.py"
NODE = ROOT / "tests" / "guara_perception" / "app" / "publishing_node.py"


@pytest.fixture
def map_file(tmp_path: Path) -> Path:
    """The map of a walk's first pause on level ground, partly scanned, partly declared."""
    robot = load_robot("guara")
    calibration = specimen(robot, (640, 512), seed=0)
    pause = next(simulate_walk(World(), robot))
    rangefinder = SimulatedRangefinder(World(), calibration, robot)
    rangefinder.set_pose(pause.transform_base_to_world, pause.joint_positions)
    processor = gp.ScanProcessor(calibration, robot, pause.stance, "coarse")
    for index, on, off in rangefinder.frames(range(0, 70, 2)):
        processor.add(index, on, off)
    pose = LegOdometry(robot).update(pause.stance)
    fused = TerrainMap(robot).update(
        processor.finish(),
        PoseInOdom(pose.transform_footprint_to_odom, pose.covariance),
        known_ground=pause.known_ground,
    )
    fused.save(tmp_path / "map.npz")
    return tmp_path / "map.npz"


@pytest.fixture
def endpoint() -> str:
    return free_endpoint()


@pytest.fixture
def node(endpoint: str, map_file: Path) -> Iterator[subprocess.Popen[str]]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    process = subprocess.Popen(
        [sys.executable, str(NODE), endpoint, "guara", str(map_file)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env=environment,
    )
    assert process.stdin is not None and process.stdout is not None
    assert process.stdout.readline().strip() == "ready"
    yield process
    process.stdin.write("quit\n")
    process.stdin.close()
    process.wait(60)


def run_example(endpoint: str, *arguments: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, str(EXAMPLE), "--connect", endpoint, *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )


def test_a_foothold_for_every_pause(node: subprocess.Popen[str], endpoint: str) -> None:
    """Each grid gets one line with the leg whose turn it is and a safe foothold near its wish, on level ground."""
    planner = run_example(endpoint, "--steps", "4")
    assert node.stdin is not None and node.stdout is not None and planner.stdout is not None
    lines = []
    for step, leg in enumerate(("rh", "rf", "lh", "lf")):
        node.stdin.write(f"map {step}\n")
        node.stdin.flush()
        assert node.stdout.readline().strip() == "done"
        line = planner.stdout.readline()
        found = re.fullmatch(
            rf"step {step}: {leg} to x ([+-][\d.]+), y ([+-][\d.]+), z ([+-][\d.]+) m, score .*\n", line
        )
        assert found, line or planner.stderr.read()
        x, y, z = map(float, found.groups())
        assert abs(x - (0.405 if leg.endswith("f") else -0.195)) <= 0.06
        assert abs(y - (0.18 if leg.startswith("l") else -0.18)) <= 0.06
        assert abs(z) < 0.006
        lines.append(line)
    assert planner.wait(60) == 0


def test_without_a_node_no_foot_moves(endpoint: str) -> None:
    """Nobody there: one line on standard error, exit code 1, no traceback."""
    start = time.monotonic()
    planner = run_example(endpoint, "--steps", "1", "--timeout", "2")
    printed, complaint = planner.communicate(timeout=90)
    assert planner.returncode == 1
    assert printed == ""
    assert complaint.startswith("no step without terrain: ")
    assert "Traceback" not in complaint
    assert time.monotonic() - start < 90


def test_the_example_is_short() -> None:
    """An example that is to be read stays under 100 lines."""
    assert len(EXAMPLE.read_text().splitlines()) < 100
