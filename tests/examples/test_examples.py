"""Every example is run as a reader would run it, in a process of its own, and says what it should."""

from __future__ import annotations

import shutil
import subprocess
import sys
import threading
from pathlib import Path

import cv2
import pytest

import guara_perception as gp
from guara_perception.app.files.convert import convert
from guara_perception.app.messages import terrain_to_message
from kinematics import RobotModel
from transport import PausePhase, StancePause, StanceReceiver, open_node
from transport.recording import RecordingWriter

EXAMPLES = Path(__file__).parents[2] / "examples"
# Run by tests of their own.
ELSEWHERE = {"foot_planner.py", "gait_side.py", "plain_zenoh.py", "relay_gait.py"}
pytestmark = pytest.mark.heavy


@pytest.fixture
def folder(tmp_path: Path, data: Path, calibration_file: Path, paper_terrain: gp.TerrainGrid) -> Path:
    """A folder with what the examples are given."""
    (tmp_path / "scans").symlink_to(data / "scans")
    (tmp_path / "pictures").symlink_to(data / "calibration")
    shutil.copy(calibration_file, tmp_path / "calibration.json")
    paper_terrain.save(tmp_path / "terrain.npz")
    with RecordingWriter(tmp_path / "walk.mcap", calibration=calibration_file.read_bytes()) as writer:
        writer.add_terrain(terrain_to_message(paper_terrain, robot="guara", sequence=1))
    return tmp_path


RUNS = {
    "read_grid.py": (["scans/paper", "calibration.json"], ["TerrainGrid: footprint", "(0.70, +0.00): 0.", "safe: "]),
    "choose_footholds.py": (["terrain.npz", "footholds.png"], ["-> ("]),
    "optimise_foothold.py": (["terrain.npz"], ["foothold x 0.", " cm2\n", "desired position: "]),
    "quadruped_pympc.py": (["terrain.npz"], ["FL: reference (0.7, 0.1) -> (", "RR: ", "returns, no safe foothold"]),
    "plan_swing.py": (["terrain.npz"], ["clearance 3", "  x +0.", "straight, 100 mm up: refused: unknown "]),
    "stride_planner.py": (["terrain.npz"], ["no leg finds a foothold"]),
    "plot_layers.py": (["terrain.npz", "layers.png"], []),
    "depth_camera.py": (["terrain.npz"], ["depth camera: ", "observed by both: ", "UNSCANNED"]),
    "height_scan_policy.py": (["terrain.npz"], ["known: ", "?"]),
    "compare_methods.py": (["scans/paper", "calibration.json"], ["GridComparison: heights b - a", "paper: "]),
    "read_recording.py": (["walk.mcap"], ["step 0: "]),
    "own_robot.py": (["guara"], ["camera 500 mm above the soles", "attitude from imu"]),
    "own_camera.py": (["pictures"], ["frame 3: 640x512"]),
    "own_board.py": ([], ["ready: ", "lit: ", "laser off"]),
}


def run(name: str, arguments: list[str], folder: Path) -> str:
    """What an example prints; it must end well and complain about nothing."""
    done = subprocess.run(
        [sys.executable, str(EXAMPLES / name), *arguments],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0 and done.stderr == "", done.stderr
    return done.stdout


@pytest.mark.sim
def test_a_policy_gets_the_same_observation_from_a_simulator(folder: Path, robot: RobotModel):
    """A level floor under the robot's own MJCF in its first keyframe: known everywhere, at height 0."""
    pytest.importorskip("mujoco", reason="extra `sim` is not installed")
    floor = '<geom type="plane" size="5 5 0.1"/>'
    scene = f'<mujoco><include file="guara.xml"/><worldbody>{floor}</worldbody></mujoco>'
    shutil.copytree(robot.folder / "mjcf", folder / "mjcf")
    (folder / "mjcf" / "scene.xml").write_text(scene)
    printed = run("height_scan_policy.py", ["mjcf/scene.xml"], folder)
    assert "known: 100%" in printed and set(printed.split()[2:]) <= {"0", "-0"}


@pytest.mark.parametrize("name", RUNS)
def test_example_runs(name: str, folder: Path):
    """Its output holds what its text promises; its pictures are pictures."""
    arguments, expected = RUNS[name]
    printed = run(name, arguments, folder)
    assert all(text in printed for text in expected), printed
    for argument in arguments:
        if argument.endswith(".png"):
            picture = cv2.imread(str(folder / argument))
            assert picture is not None and picture.std() > 10


def test_recording_with_a_scan_is_processed_again(folder: Path, data: Path, calibration_file: Path):
    """The frames of a recorded scan give a finer grid."""
    scan = Path(shutil.copytree(data / "scans" / "paper", folder / "carrying"))
    shutil.copy(calibration_file, scan / "calibration.json")
    convert(scan, folder / "frames.mcap")
    assert "cells of 2.5 mm" in run("read_recording.py", ["frames.mcap"], folder)


def test_every_example_is_run():
    """None is left out, and each says how to start it."""
    there = {path.name for path in EXAMPLES.glob("*.py")} - {"arguments.py"}
    assert there == set(RUNS) | ELSEWHERE
    for name in there:
        assert f"python examples/{name}" in (EXAMPLES / name).read_text()


def test_gait_announces_its_pauses(free_endpoint: str, tmp_path: Path):
    """BEGIN, HOLDs and END of each pause arrive in order, all of one walk, the joints read anew each time."""
    heard: list[StancePause] = []
    complete = threading.Event()

    def take(pause: StancePause) -> None:
        heard.append(pause)
        if (pause.step, pause.phase) == (1, PausePhase.END):
            complete.set()

    with open_node(listen=free_endpoint) as session:
        StanceReceiver(session, robot="guara", on_pause=take)
        run("gait_side.py", [free_endpoint, "--pauses", "2", "--seconds", "0.5"], tmp_path)
        assert complete.wait(60)
    for step in (0, 1):
        phases = [pause.phase for pause in heard if pause.step == step]
        assert (phases[0], phases[-1]) == (PausePhase.BEGIN, PausePhase.END)
        assert phases[1:-1] and set(phases[1:-1]) == {PausePhase.HOLD}
    readings = [tuple(pause.stance.joint_positions.values()) for pause in heard]
    assert len(set(readings)) == len(readings)
    assert len({pause.epoch for pause in heard}) == 1 and heard[0].epoch
