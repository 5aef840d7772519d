"""`guara view --rerun`: a recording becomes one file that Rerun opens as a scene; other files are refused."""

import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

import guara_perception as gp
from guara_perception.app.main import run
from guara_perception.app.messages import terrain_to_message
from guara_perception.app.node.recorder import ScanRecorder
from guara_perception.app.scene import rerun_scene
from guara_perception.app.scene.scene import Scene
from guara_perception.scanning.process import run_scan
from guara_perception.terrain.map.terrain_map import TerrainMap
from kinematics import LegOdometry, PoseInOdom, RobotModel
from transport.recording import RecordingWriter

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def walk(
    tmp_path_factory: pytest.TempPathFactory,
    paper_scan: gp.Scan,
    paper_terrain: gp.TerrainGrid,
    calibration: gp.Calibration,
    robot: RobotModel,
) -> Path:
    """Recording of one pause as the node writes it."""
    path = tmp_path_factory.mktemp("walk") / "walk.mcap"
    pose = LegOdometry(robot).update(paper_scan.stance)
    fused = TerrainMap(robot).update(paper_terrain, PoseInOdom(pose.transform_footprint_to_odom, pose.covariance))
    scene = Scene(robot, calibration)
    with ScanRecorder(path, robot="guara", calibration=calibration, jpeg_quality=90, scene=scene) as recorder:
        recording = recorder.begin(0, "coarse", paper_scan.stance)
        stripe = paper_scan.stripes[0]
        frame = np.asarray(paper_scan.read_frame(stripe.on))
        recording.add(
            SimpleNamespace(
                index=stripe.index, mirror_angle=stripe.mirror_angle, on=frame, off=frame, dark=None, is_dark_due=False
            )
        )
        recorder.add_points(run_scan(paper_scan, calibration, robot).points, paper_terrain.stamp)
        messages = tuple(terrain_to_message(terrain, robot="guara", sequence=1) for terrain in (paper_terrain, fused))
        recording.finish(messages, None)
    return path


def _rerun(*arguments: object) -> str:
    done = subprocess.run(
        [sys.executable, "-m", "rerun", *map(str, arguments)], capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout + done.stderr


@pytest.mark.heavy
def test_a_recording_becomes_a_scene(walk: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Rerun itself reads the file and finds robot, coloured terrain, stripes, markers and images."""
    pytest.importorskip("rerun", reason="extra `rerun` is not installed")
    out = tmp_path / "walk.rrd"
    assert run(["view", "--rerun", str(walk), "--save", str(out)]) == 0
    assert f"{out}: open it with `rerun {out}`" in capsys.readouterr().out
    assert "verified without error" in _rerun("rrd", "verify", out)
    stats = _rerun("rrd", "stats", out)
    for entity in (
        "/guara/scene/terrain",
        "/guara/scene/stripes",
        "/guara/scene/obstacles",
        "/guara/scene/footholds",
        "/guara/scene/regions",
        "/guara/visual_geometries/base_link",
        "/guara/camera/on/compressed",
        "/guara/camera/camera_info",
        "/tf",
    ):
        assert entity in stats, entity
    assert "/viewport" in stats  # the blueprint


@pytest.mark.heavy
def test_rerun_finds_nothing_wrong_with_a_recording(walk: Path) -> None:
    """No chunk is out of order on any timeline."""
    pytest.importorskip("rerun", reason="extra `rerun` is not installed")
    report = _rerun("mcap", "check", "--full", walk)
    assert "PROBLEM" not in report and "ros2_timestamp" in report
    assert report.count("\nok ") >= 18


def test_without_a_display_it_says_what_to_do(
    walk: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit 1 with one line."""
    pytest.importorskip("rerun", reason="extra `rerun` is not installed")
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"):
        monkeypatch.delenv(name, raising=False)
    assert run(["view", "--rerun", str(walk)]) == 1
    error = capsys.readouterr().err
    assert "the Rerun viewer ended with code" in error and "--save walk.rrd writes" in error


def test_without_rerun_one_line_says_what_to_install(
    walk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """No file is written."""
    monkeypatch.setitem(sys.modules, "rerun", None)
    assert run(["view", "--rerun", str(walk), "--save", str(tmp_path / "a.rrd")]) == 1
    assert "needs rerun: pip install 'guara-perception[rerun]'" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_files_without_a_scene_are_refused(tmp_path: Path, walk: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Other files, recordings of earlier versions, and names that Rerun cannot open: exit 2 with the remedy."""
    pytest.importorskip("rerun", reason="extra `rerun` is not installed")
    bare = tmp_path / "bare.mcap"
    with RecordingWriter(bare, robot="guara"):
        pass
    picture = tmp_path / "a.png"
    cv2.imwrite(str(picture), np.zeros((2, 2), np.uint8))
    (tmp_path / "cut.mcap").write_bytes(walk.read_bytes()[:3000])
    out = str(tmp_path / "a.rrd")
    for arguments, reported in (
        ([str(bare), "--save", out], "contains no scene"),
        ([str(picture), "--save", out], "Rerun shows recordings (.mcap)"),
        ([str(tmp_path / "none.mcap"), "--save", out], "no such file"),
        ([str(tmp_path / "cut.mcap"), "--save", out], "guara convert"),
        ([str(walk), "--save", str(tmp_path / "a.txt")], "must end in .rrd"),
        ([], "give its FILE"),
    ):
        assert run(["view", "--rerun", *arguments]) == 2, arguments
        assert reported in capsys.readouterr().err
    assert run(["view", "--rerun", "-c", "calibration.json", str(walk)]) == 2
    assert "-c is for the view in a browser" in capsys.readouterr().err
    assert run(["view", str(walk), "--save", out]) == 2
    assert "--save requires --rerun" in capsys.readouterr().err
    assert not Path(out).exists()


def test_every_shape_of_the_robot_is_drawn_solid(robot: RobotModel) -> None:
    """With the entity names of Rerun's URDF importer; a text that is not a URDF gives no shapes."""
    pytest.importorskip("rerun", reason="extra `rerun` is not installed")
    from rerun.urdf import UrdfTree

    tree = UrdfTree.from_file_path(str(robot.tree.urdf.path))
    named = {path for link in robot.tree.links for path in tree.get_visual_geometry_paths(tree.get_link_by_name(link))}
    found = dict(rerun_scene.solid_shapes(robot.tree.urdf.text))
    assert set(found) == named and len(named) == 62
    assert all(shape.fill_mode is not None for shape in found.values())
    assert dict(rerun_scene.solid_shapes("")) == {}
