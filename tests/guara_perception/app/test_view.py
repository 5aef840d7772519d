"""Moments for the viewer from each kind of file, and live."""

from __future__ import annotations

import dataclasses
import shutil
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import guara_perception as gp
from drivers import StripeCapture, StripeVerdict
from guara_perception.app.commands import view
from guara_perception.app.commands.view import show_live
from guara_perception.app.live_moments import LiveMoments
from guara_perception.app.messages import stance_to_message, terrain_to_message
from guara_perception.app.node.recorder import ScanRecorder
from guara_perception.app.scene.scene import range_image_messages
from guara_perception.app.view_moments import load_moments
from guara_perception.exceptions import FileFormatError, InvalidInput, MissingFile
from guara_perception.view.moment import Moment
from kinematics import RobotModel, load_robot
from transport import point_cloud_message
from transport.recording import FrameRecord, RecordingWriter, ScanRecord

pytestmark = pytest.mark.slow

NODE = Path(__file__).with_name("publishing_node.py")


def test_a_grid_file_is_one_moment(terrain_file: Path, robot: RobotModel, paper_terrain: gp.TerrainGrid) -> None:
    """An .npz file shows its grid with its stance."""
    _, (moment,) = load_moments(terrain_file, robot)
    np.testing.assert_array_equal(moment.grids["footprint"].elevation, paper_terrain.elevation)
    assert moment.joint_positions == paper_terrain.metadata["stance"]["joint_positions"]
    assert moment.transform_base_to_footprint[2, 3] == pytest.approx(0.36, abs=1e-3)
    assert moment.stripes is None


def test_a_scan_folder_shows_its_stripes(data: Path, robot: RobotModel, calibration: gp.Calibration) -> None:
    """With a calibration, a folder is processed: a grid, and the points of its stripes on the ground."""
    _, (moment,) = load_moments(data / "scans" / "paper", robot, calibration)
    stripes = moment.stripes()
    assert len(stripes) == 35
    points = np.vstack(stripes)
    points = points[np.isfinite(points).all(axis=1)]
    assert len(points) > 10_000
    assert np.abs(np.median(points[:, 2])) < 0.005
    picture = moment.picture()
    assert picture is not None and picture.shape == (512, 640, 3)
    assert moment.picture() is picture
    with pytest.raises(InvalidInput, match=r"paper has no calibration.json: give the calibration .* \(-c\)"):
        load_moments(data / "scans" / "paper", robot)
    with pytest.raises(MissingFile, match="not a scan; this is the folder of a calibration session"):
        load_moments(data / "calibration", robot)


def test_a_scan_folder_that_carries_its_calibration_needs_no_other(
    tmp_path: Path, data: Path, robot: RobotModel, calibration_file: Path
) -> None:
    """As for `guara process` and `guara replay`."""
    shutil.copytree(data / "scans" / "paper", tmp_path / "paper")
    shutil.copy(calibration_file, tmp_path / "paper" / "calibration.json")
    _, (moment,) = load_moments(tmp_path / "paper", robot)
    assert len(moment.stripes()) == 35


def test_a_recording_shows_its_grids_in_order(
    tmp_path: Path, robot: RobotModel, paper_terrain: gp.TerrainGrid, calibration: gp.Calibration
) -> None:
    """Each step of a recorded walk is a moment with scan and map; a recording without grids or scans is refused."""
    path = tmp_path / "walk.mcap"
    with RecordingWriter(path, robot="guara") as writer:
        for step in (3, 4, 5):
            scan = dataclasses.replace(paper_terrain, step=step, stamp=step, pictures={})
            writer.add_terrain(terrain_to_message(scan, robot="guara", sequence=step))
            if step > 3:
                fused = dataclasses.replace(scan, extent="map")
                writer.add_terrain(terrain_to_message(fused, robot="guara", sequence=step))
    _, moments = load_moments(path, robot)
    assert [moment.step for moment in moments] == [3, 4, 5]
    assert [set(moment.grids) for moment in moments] == [{"footprint"}, {"footprint", "map"}, {"footprint", "map"}]
    empty = tmp_path / "empty.mcap"
    with RecordingWriter(empty, robot="guara"):
        pass
    with pytest.raises(FileFormatError, match="holds neither grids nor scans: there is nothing to show"):
        load_moments(empty, robot)


def test_what_was_confirmed_is_no_longer_provisional_in_a_recording(
    tmp_path: Path, robot: RobotModel, paper_terrain: gp.TerrainGrid
) -> None:
    """Grids are recorded as first sent; the images of a scan, and no others, show that it was confirmed."""
    path = tmp_path / "walk.mcap"
    with RecordingWriter(path, robot="guara") as writer:
        for step in (3, 4):
            scan = dataclasses.replace(paper_terrain, step=step, stamp=step * 10**9).restated(provisional=True)
            for extent in ("footprint", "map"):
                sent = terrain_to_message(
                    dataclasses.replace(scan, extent=extent, pictures={}), robot="guara", sequence=step
                )
                writer.add_terrain(sent)
            if step == 3:
                writer.add_messages(range_image_messages(scan).items())
    _, (confirmed, other) = load_moments(path, robot)
    assert {extent: grid.is_provisional for extent, grid in confirmed.grids.items()} == {
        "footprint": False,
        "map": False,
    }
    assert all(grid.is_provisional for grid in other.grids.values())


def test_two_walks_of_one_recording_stay_apart(
    tmp_path: Path, robot: RobotModel, paper_terrain: gp.TerrainGrid, paper_scan: gp.Scan, calibration: gp.Calibration
) -> None:
    """A gait that restarts at 0 gives separate moments: grids and scans of a step stay with their walk."""
    path = tmp_path / "walks.mcap"
    with RecordingWriter(path, robot="guara") as writer:
        stamp = 0
        for walk in ("first", "second"):
            for step in (1, 2):
                stamp += 10
                stance = stance_to_message(paper_scan.stance)
                record = ScanRecord(robot="guara", mode="coarse", stamp=stamp - 5, step=step, stance=stance)
                writer.begin_scan(record)
                frame = FrameRecord(pixels=np.full((4, 4), stamp, np.uint8), stamp=stamp - 1)
                writer.add_stripe(0, 0.0, writer.add_frame(frame, laser_on=True), None, stamp=stamp - 1)
                writer.end_scan(stamp=stamp)
                metadata = {**paper_terrain.metadata, "epoch": walk}
                for extent in ("footprint", "map"):
                    scan = dataclasses.replace(
                        paper_terrain,
                        step=step,
                        stamp=stamp,
                        pictures={},
                        record=gp.ScanRecord.from_json(metadata),
                        extent=extent,
                    )
                    writer.add_terrain(terrain_to_message(scan, robot="guara", sequence=stamp, scan_start=stamp - 5))
    _, moments = load_moments(path, robot)
    assert [moment.step for moment in moments] == [1, 2, 1, 2]
    grids = [grid for moment in moments for grid in moment.grids.values()]
    assert [grid.stamp for grid in grids] == [10, 10, 20, 20, 30, 30, 40, 40]
    pictures = [moment.picture() for moment in moments]
    assert [picture is not None and int(picture[0, 0]) for picture in pictures] == [10, 20, 30, 40]


def test_recorded_points_are_shown_as_they_were_measured(
    tmp_path: Path, robot: RobotModel, paper_terrain: gp.TerrainGrid
) -> None:
    """Recorded points belong to the scan with the same stamp; nothing is processed for them."""
    path = tmp_path / "walk.mcap"
    xyz = {name: np.linspace(0.5, 0.9, 7, dtype=np.float32) for name in "xyz"}
    with RecordingWriter(path, robot="guara") as writer:
        for step in (1, 2):
            scan = dataclasses.replace(paper_terrain, step=step, stamp=step, pictures={})
            writer.add_terrain(terrain_to_message(scan, robot="guara", sequence=step))
        writer.add_messages([("scan/points", point_cloud_message(xyz, "base_footprint", 2))])
    _, (first, second) = load_moments(path, robot)
    assert first.stripes is None and first.picture is None
    np.testing.assert_allclose(second.stripes()[0][:, 0], xyz["x"])


def test_a_recording_of_scans_needs_a_calibration(
    guara: Callable, tmp_path: Path, data: Path, robot: RobotModel, calibration: gp.Calibration
) -> None:
    """Recorded frames without grids are processed with the given calibration, and refused without."""
    path = tmp_path / "scan.mcap"
    assert guara("convert", data / "scans" / "paper", path).code == 0
    _, (moment,) = load_moments(path, robot, calibration)
    assert np.isfinite(moment.grids["footprint"].elevation).mean() > 0.7
    assert len(moment.stripes()) == 35
    with pytest.raises(InvalidInput, match="holds scans but no grids: give the calibration"):
        load_moments(path, robot)


def test_a_recording_that_carries_its_calibration_needs_no_other(
    tmp_path: Path, robot: RobotModel, paper_scan: gp.Scan, calibration: gp.Calibration
) -> None:
    """The calibration attached by the recorder is used; a damaged one is named."""
    path = tmp_path / "scan.mcap"
    with ScanRecorder(path, robot="guara", calibration=calibration) as recorder:
        recording = recorder.begin(0, paper_scan.mode, paper_scan.stance)
        for stripe, on, off in paper_scan.frames():
            angle = stripe.mirror_angle
            recording.add(StripeCapture(stripe.index, angle, angle, on, off, 0.0, 0.0, StripeVerdict.OK, None))
        recording.finish((), None)
    _, (moment,) = load_moments(path, robot)
    assert len(moment.stripes()) == 35
    damaged = tmp_path / "damaged.mcap"
    with RecordingWriter(damaged, robot="guara", calibration=b"{}"):
        pass
    with pytest.raises(FileFormatError, match=r"damaged.mcap: calibration.json: format is missing"):
        load_moments(damaged, robot)


def test_the_robot_of_a_file_is_the_default(
    guara: Callable, tmp_path: Path, terrain_file: Path, paper_terrain: gp.TerrainGrid, edited_scan: Callable
) -> None:
    """Of a grid, a scan folder, a recording of scans and one of grids, if no robot is given."""
    assert load_moments(terrain_file)[0].name == "guara"
    folder = edited_scan(lambda scan: scan.update(robot="tapir"))
    assert guara("convert", folder, tmp_path / "scan.mcap").code == 0
    with RecordingWriter(tmp_path / "grids.mcap", robot="lobo") as writer:
        grid = dataclasses.replace(paper_terrain, pictures={})
        writer.add_terrain(terrain_to_message(grid, robot="lobo", sequence=1))
    assert load_moments(tmp_path / "grids.mcap")[0].name == "guara"
    for path in folder, tmp_path / "scan.mcap":
        said = guara("view", path)
        assert said.code == 2 and "no robot 'tapir'" in said.err


def test_what_cannot_be_shown_is_refused(guara: Callable, tmp_path: Path, robot: RobotModel) -> None:
    """Missing, foreign and damaged files: one line and exit code 2."""
    with pytest.raises(MissingFile, match="nowhere.npz: no such file or folder"):
        load_moments(tmp_path / "nowhere.npz", robot)
    (tmp_path / "notes.txt").write_text("")
    with pytest.raises(InvalidInput, match=r"allowed: a grid \(.npz\), a recording \(.mcap\) or a scan folder"):
        load_moments(tmp_path / "notes.txt", robot)
    (tmp_path / "cut.mcap").write_bytes(b"\x89MCAP0\r\n")
    with pytest.raises(FileFormatError, match="cut.mcap"):
        load_moments(tmp_path / "cut.mcap", robot)
    said = guara("view", tmp_path / "nowhere.npz")
    assert said.code == 2
    assert "nowhere.npz: no such file or folder" in said.err


def test_live_grids_are_shown_as_they_come(
    start: Callable, free_endpoint: str, terrain_file: Path, robot: RobotModel, eventually: Callable
) -> None:
    """Every grid that a node publishes becomes a moment, until stopped."""
    node = start(NODE, free_endpoint, "guara", terrain_file)
    assert node.line() == "ready"
    shown: list[Moment] = []
    stop = threading.Event()
    arguments = (shown.append, robot, free_endpoint, "guara", None, stop, "http://127.0.0.1:1")
    viewer = threading.Thread(target=show_live, args=arguments)
    viewer.start()
    try:
        node.tell("publish 1")
        assert eventually(lambda: any(moment.step == 1 for moment in shown))
        assert shown[-1].stripes is None and shown[-1].picture is None
        node.tell("views")
        assert eventually(lambda: shown[-1].picture is not None and shown[-1].stripes is not None)
        (points,) = shown[-1].stripes()
        np.testing.assert_allclose(points, np.repeat(np.linspace(0.5, 0.9, 9)[:, None], 3, axis=1), atol=1e-6)
        assert shown[-1].picture().shape == (40, 60, 3) and shown[-1].step == 1
        node.tell("map 1")
        assert eventually(lambda: set(shown[-1].grids) == {"footprint", "map"})
        assert shown[-1].stripes is not None and shown[-1].picture is not None
        # Nothing of an earlier scan is shown beside a later one.
        node.tell("map 2")
        assert eventually(lambda: shown[-1].step == 2)
        assert set(shown[-1].grids) == {"map"} and shown[-1].stripes is None and shown[-1].picture is None
    finally:
        stop.set()
        viewer.join(60)
    assert not viewer.is_alive()
    count = len(shown)
    node.tell("publish 3")
    time.sleep(0.3)
    assert len(shown) == count


def test_a_live_view_says_how_old_its_ground_is_and_that_its_node_is_gone(
    start: Callable, free_endpoint: str, terrain_file: Path, robot: RobotModel, eventually: Callable
) -> None:
    """The last grid of a dead node stays on the page, marked red with the reason; nothing new is shown."""
    node = start(NODE, free_endpoint, "guara", terrain_file)
    assert node.line() == "ready"
    shown: list[Moment] = []
    with LiveMoments(shown.append, robot, free_endpoint, robot="guara") as moments:
        assert moments.state() == ("", False)
        node.tell("pause 1 walk-a")
        node.tell("publish 1 0 walk-a")
        assert eventually(lambda: bool(shown))
        text, is_stale = moments.state()
        assert text.startswith("footprint of step 1, ") and text.endswith(" s old") and not is_stale
        node.popen.kill()
        assert eventually(lambda: moments.state()[1])
        assert "is no longer confirmed: its node is gone" in moments.state()[0]
        assert all(moment.step == 1 for moment in shown)


def test_a_live_view_of_another_robot_says_so(
    start: Callable,
    free_endpoint: str,
    terrain_file: Path,
    root: Path,
    caplog: pytest.LogCaptureFixture,
    eventually: Callable,
) -> None:
    """Joints that the drawn robot does not have give one line that names the robot, and no traceback."""
    node = start(NODE, free_endpoint, "guara", terrain_file)
    assert node.line() == "ready"
    tapir = load_robot(root / "tests" / "robots" / "tapir")
    with LiveMoments(lambda moment: tapir.state(moment.joint_positions or {}), tapir, free_endpoint, robot="guara"):
        node.tell("publish 1")
        assert eventually(lambda: "cannot show a grid that does not match robot 'tapir' (--robot): " in caplog.text)
    assert "Traceback" not in caplog.text


def test_a_live_view_without_anything_to_show_says_what_it_waits_for(
    start: Callable,
    free_endpoint: str,
    terrain_file: Path,
    robot: RobotModel,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    eventually: Callable,
) -> None:
    """Unknown name: one line with the running robots. Robot without a grid: one line that says so."""
    monkeypatch.setattr(view, "SILENCE", 0.2)
    node = start(NODE, free_endpoint, "rex", terrain_file)
    assert node.line() == "ready"
    for instance, expected_text in (
        ("guara", "name 'guara': no such node on this router; running here: rex (select one with --name)\n"),
        ("rex", "waiting for the first grid of 'rex': its node is running but has sent no usable grid yet\n"),
    ):
        stop, said = threading.Event(), ""
        arguments = (lambda _: None, robot, free_endpoint, instance, None, stop, "http://127.0.0.1:1")
        viewer = threading.Thread(target=show_live, args=arguments)
        viewer.start()

        def heard(expected_text: str = expected_text) -> bool:
            nonlocal said
            said += capsys.readouterr().err
            return expected_text in said

        try:
            assert eventually(heard)
        finally:
            stop.set()
            viewer.join(60)
    with LiveMoments(lambda _: None, robot, free_endpoint, robot="rex") as moments:
        node.tell("publish 1")
        assert eventually(lambda: moments.missing() == "")
