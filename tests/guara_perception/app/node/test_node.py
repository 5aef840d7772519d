"""Node end to end: real Zenoh, the real driver over an emulated board, and gait and planner as clients."""

import resource
import threading
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

import cv2
import numpy as np
import pytest

import guara_perception as gp
from drivers import CameraSettings
from drivers.board.protocol import Request
from guara_perception.app.files.open_scan import open_scans
from guara_perception.app.messages import message_to_terrain
from guara_perception.app.node.claim import Seal
from guara_perception.app.node.journal import Journal
from guara_perception.app.node.recorder import ScanRecorder
from guara_perception.app.node.walk_map import WalkMap
from guara_perception.app.scene.scene import Scene, cloud_points
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK
from kinematics import RobotModel, Stance
from testbed.bench_board import Fault, FaultKind
from tests.guara_perception.app.node.conftest import Rig
from tests.guara_perception.app.node.live_bench import TIMEOUT, Bench, wait_until
from transport import Health, PausePhase
from transport.keys import RANGE_IMAGES, perception_key, picture_key, points_key
from transport.links.receiver import NewestReceiver
from transport.messages.codec import decode, read_time
from transport.messages.typestore import COMPRESSED_IMAGE, IMAGE, POINT_CLOUD
from transport.recording import open_recording

pytestmark = pytest.mark.slow


def test_each_pause_gives_a_grid_and_a_map(bench: Bench) -> None:
    """Two pauses: the planner receives both extents of both steps, as in the recording."""
    for step in (0, 1):
        bench.gait.say(step, PausePhase.BEGIN)
        terrain = bench.client.wait_for_step(step, timeout=TIMEOUT)
        fused = bench.client.wait_for_step(step, timeout=TIMEOUT, extent="map")
        bench.gait.say(step, PausePhase.END)
        assert (terrain.step, fused.step) == (step, step)
        np.testing.assert_array_equal(terrain.hazard, bench.rig.reference.hazard)
        assert fused.extent == "map"
        assert not np.any((fused.traversability > 0) & ((fused.hazard & UNKNOWN_MASK) != 0))
    assert np.isfinite(fused.elevation).sum() >= np.isfinite(terrain.elevation).sum() * 0.95
    # The status is published after the grid.
    expected = {
        "calibration",
        "drift",
        "foot_slip",
        "joints",
        "light",
        "pause",
        "scanner",
        "stillness",
        "thread guara-scans",
    }
    assert wait_until(lambda: {item.name for item in bench.status.items()} == expected)
    levels = {item.name: item.level for item in bench.status.items() if item.level is not Health.OK}
    # Two readings per pause are too few to detect a millimetre.
    assert levels == {"stillness": Health.WARN}


def test_a_joint_that_jumps_between_two_pauses_is_told(bench: Bench) -> None:
    """Status and health of the next grid name the joint; a new walk begins without a reference."""
    wrong = "rh_kfe_joint"
    joints = dict(bench.gait.stance.joint_positions)
    joints[wrong] += 0.1
    jumped = Stance(joints, bench.gait.stance.support_feet, bench.gait.stance.gravity_in_base)

    def told() -> tuple[Health, str, dict[str, str]]:
        (item,) = (item for item in bench.status.items() if item.name == "joints")
        return item.level, item.message, dict(item.values)

    for step, stance in ((0, None), (1, None), (2, jumped)):
        bench.gait.say(step, PausePhase.BEGIN, stance, epoch="a")
        terrain = bench.client.wait_for_step(step, timeout=TIMEOUT)
        level, message, values = told()
        if step < 2:
            assert level is Health.OK and float(values["residual"]) == pytest.approx(0.0, abs=0.01) or step == 0
        bench.gait.say(step, PausePhase.END, stance, epoch="a")
    assert level is Health.WARN and wrong in message and wrong in values["joints"] and values["step"] == "2"
    assert terrain.metadata["health"]["level"] == "degraded"
    assert any(f"joint {wrong}" in reason for reason in terrain.metadata["health"]["reasons"])
    bench.gait.say(0, PausePhase.BEGIN, epoch="b")
    assert wait_until(lambda: told()[0] is Health.OK)


def test_the_mirror_stands_at_the_first_stripe_before_the_first_pause(bench: Bench) -> None:
    """The board is homed while nobody waits, not during the first pause."""
    _, first = bench.rig.firing_order[0]
    assert wait_until(lambda: abs(bench.rig.board.view().mirror_angle - first) < 1e-3)


def test_views_get_points_and_picture_of_each_scan(bench: Bench, paper_scan: gp.Scan) -> None:
    """With the stamp of the grid: the points of the stripes, and the frame of the median stripe."""
    session = bench.gait.session
    points = NewestReceiver(session, points_key(), lambda payload: decode(payload, POINT_CLOUD))
    pictures = NewestReceiver(session, picture_key(), lambda payload: decode(payload, COMPRESSED_IMAGE))
    bench.gait.say(0, PausePhase.BEGIN)
    terrain = bench.client.wait_for_step(0, timeout=TIMEOUT)
    cloud = points.wait_for(lambda _: True, TIMEOUT).message
    assert read_time(cloud.header.stamp) == terrain.stamp
    x, y, z = cloud_points(cloud).T
    assert len(x) > 4000
    np.testing.assert_allclose(np.nanmedian(terrain.height_at(x, y) - z), 0.0, atol=1e-3)
    message = pictures.wait_for(lambda _: True, TIMEOUT).message
    assert read_time(message.header.stamp) == terrain.stamp
    seen = cv2.imdecode(message.data, cv2.IMREAD_COLOR)
    frame_name = {stripe.index: stripe.on for stripe in paper_scan.stripes}[34]
    wanted = cv2.resize(paper_scan.read_frame(frame_name), (480, 384), interpolation=cv2.INTER_AREA)
    assert np.abs(seen.astype(int) - wanted).mean() < 4.0


def test_a_confirmed_scan_gives_its_range_images(bench: Bench) -> None:
    """Three images with the stamp of the grid, which reproduce its hazards; all unknown after a withdrawal."""
    receivers = [
        NewestReceiver(bench.gait.session, perception_key(name), lambda payload: decode(payload, IMAGE))
        for name in RANGE_IMAGES
    ]
    bench.gait.say(0, PausePhase.BEGIN)
    bench.client.wait_for_step(0, timeout=TIMEOUT)
    bench.gait.say(0, PausePhase.HOLD)
    terrain = bench.client.wait_for_step(0, timeout=TIMEOUT, confirmed_only=True)
    heights, causes, sigma = (receiver.wait_for(lambda _: True, TIMEOUT).message for receiver in receivers)
    assert {read_time(each.header.stamp) for each in (heights, causes, sigma)} == {terrain.stamp}
    assert [each.encoding for each in (heights, causes, sigma)] == ["32FC1", "8UC1", "32FC1"]
    shape = heights.height, heights.width
    again = gp.terrain_from_range_image(
        1e3 * heights.data.view(np.float32).reshape(shape),
        causes.data.reshape(shape),
        sigma_mm=1e3 * sigma.data.view(np.float32).reshape(shape),
    )
    assert shape == (512, 640) and (again.hazard != terrain.hazard).mean() < 0.02
    assert not ((again.hazard == 0) & (terrain.hazard != 0)).any()
    bench.gait.say(0, PausePhase.END, bench.gait.moved())
    receivers[0].wait_for(lambda image: bool(np.isnan(image.data.view(np.float32)).all()), TIMEOUT)


def test_a_scan_is_refused_while_the_robot_walks_and_done_while_it_stands(bench: Bench) -> None:
    """A request before the first pause fails with the reason; during a pause it gives a grid."""
    with pytest.raises(gp.ScanFailed, match="not in a stance pause"):
        bench.client.request_scan("coarse", timeout=TIMEOUT)
    bench.gait.say(0, PausePhase.BEGIN)
    first = bench.client.wait_for_step(0, timeout=TIMEOUT)
    seen: list[int] = []
    again = bench.client.request_scan(
        "coarse", timeout=TIMEOUT, on_progress=lambda reply: seen.append(reply.stripes_done)
    )
    assert again.metadata["sequence"] > first.metadata["sequence"]
    np.testing.assert_array_equal(again.hazard, first.hazard)
    assert seen and seen == sorted(seen)


def test_a_pause_that_ends_early_stops_the_scan(bench: Bench) -> None:
    """The remaining cells are unknown, health states the reason, and the next pause is scanned normally."""
    usual, bench.rig.camera._period = bench.rig.camera._period, 0.05
    _, middle = bench.rig.firing_order[len(bench.rig.firing_order) // 3]
    _, first = bench.rig.firing_order[0]
    bench.gait.say(0, PausePhase.BEGIN)
    assert wait_until(lambda: bench.rig.board.view().laser_on)
    assert wait_until(lambda: abs(bench.rig.board.view().mirror_angle - first) > abs(middle - first))
    bench.gait.say(0, PausePhase.END)
    cut = bench.client.wait_for_step(0, timeout=TIMEOUT)
    assert bench.rig.never_safer(cut) and not cut.is_provisional
    assert 0.05 < cut.metadata["known"] < 0.8 * bench.rig.reference.metadata["known"]
    assert "the pause ended before the scan" in cut.metadata["health"]["reasons"]
    bench.rig.camera._period = usual
    bench.gait.say(1, PausePhase.BEGIN)
    np.testing.assert_array_equal(bench.client.wait_for_step(1, timeout=TIMEOUT).hazard, bench.rig.reference.hazard)


def test_automatic_exposure_that_is_on_again_shows_in_health_and_status(bench: Bench) -> None:
    """It is named with the remedy; once it is off again, the next scan is good."""
    bench.rig.rangefinder.lock(CameraSettings(exposure=0.004))
    bench.rig.camera.automatic.add("exposure")
    bench.gait.say(0, PausePhase.BEGIN)
    health = bench.client.wait_for_step(0, timeout=TIMEOUT).metadata["health"]
    bench.gait.say(0, PausePhase.END)
    # A busy machine may lose a frame of the scan, which is another reason.
    (reason,) = (each for each in health["reasons"] if "automatic exposure" in each)
    assert health["level"] == "degraded"
    assert "automatic exposure is on, it was locked at 0.004 s: check that no other program" in reason
    assert wait_until(
        lambda: any(
            item.name == "scanner" and item.level == Health.WARN and reason in item.message
            for item in bench.status.items()
        )
    )
    bench.rig.camera.automatic.clear()
    bench.gait.say(1, PausePhase.BEGIN)
    reasons = bench.client.wait_for_step(1, timeout=TIMEOUT).metadata["health"]["reasons"]
    assert not any("automatic exposure" in each for each in reasons)


def test_a_scan_during_which_the_camera_moved_is_not_published(bench: Bench) -> None:
    """The stance at the end differs: the scan is rejected, the status says so, and the next pause is scanned."""
    joints = dict(bench.gait.stance.joint_positions)
    for joint in joints:
        if "kfe" in joint:
            joints[joint] += 0.02
    moved = Stance(joints, bench.gait.stance.support_feet, bench.gait.stance.gravity_in_base)
    bench.gait.say(0, PausePhase.BEGIN)
    assert wait_until(lambda: bench.rig.board.view().laser_on)
    bench.gait.say(0, PausePhase.END, moved)
    assert wait_until(lambda: any("camera moved" in item.message for item in bench.status.items()))
    bench.gait.say(1, PausePhase.BEGIN)
    assert bench.client.wait_for_step(0, timeout=TIMEOUT).step == 1
    assert wait_until(lambda: all(item.level is Health.OK for item in bench.status.items()))


def test_a_stance_that_is_no_stance_is_not_scanned(bench: Bench) -> None:
    """An unknown foot is reported in the status; no grid of this pause is published."""
    wrong = Stance(bench.gait.stance.joint_positions, ("lf", "xx", "rh"), None)
    bench.gait.say(0, PausePhase.BEGIN, wrong)
    assert wait_until(lambda: any("xx" in item.message for item in bench.status.items()))
    bench.gait.say(1, PausePhase.BEGIN)
    assert bench.client.wait_for_step(0, timeout=TIMEOUT).step == 1


def test_a_grid_scanned_with_a_slipped_mirror_is_withdrawn(bench: Bench) -> None:
    """Homing detects the lost steps: an all-unknown grid follows, and the scan is not fused."""
    # Subscribe now: an extent is received only from its first use.
    assert bench.client.counts()["received"] == 0
    bench.rig.board.inject(Fault(FaultKind.LOST_STEP, Request.GO_TO, skip=10, amount=40))
    bench.gait.say(0, PausePhase.BEGIN)
    assert wait_until(lambda: any("lost" in item.message for item in bench.status.items()))
    assert wait_until(lambda: bench.client.counts()["received"] >= 2)
    withdrawn = bench.client.latest(allow_stale=True)
    assert not np.isfinite(withdrawn.elevation).any()
    assert withdrawn.metadata["health"]["level"] == "failed"
    assert bench.client.counts("map")["received"] == 0
    bench.gait.say(1, PausePhase.BEGIN)
    np.testing.assert_array_equal(bench.client.wait_for_step(1, timeout=TIMEOUT).hazard, bench.rig.reference.hazard)


def test_a_recording_can_be_processed_again(
    rig: Rig,
    bench_with: Callable[..., AbstractContextManager[Bench]],
    robot: RobotModel,
    calibration: gp.Calibration,
    tmp_path: Path,
) -> None:
    """The recording reproduces the grids that the node published."""
    path = tmp_path / "walk.mcap"
    recorder = ScanRecorder(path, robot="guara", calibration=calibration, scene=Scene(robot, calibration))
    with recorder, bench_with(recorder) as bench:
        for step in (0, 1):
            bench.gait.say(step, PausePhase.BEGIN)
            bench.client.wait_for_step(step, timeout=TIMEOUT, extent="map")
            bench.gait.say(step, PausePhase.END)
        assert wait_until(lambda: bench.node._pause is not None and bench.node._pause.ended.is_set())
    scans = open_scans(path)
    assert [scan.step for scan in scans] == [0, 1] and scans[0].epoch == scans[1].epoch != ""
    terrain = gp.process_scan(scans[1], calibration, robot, pictures=False)
    np.testing.assert_array_equal(terrain.hazard, rig.reference.hazard)
    with open_recording(path) as recording:
        pauses = [pause.phase for pause in recording.stance_pauses()]
        assert pauses == [PausePhase.BEGIN, PausePhase.END] * 2
        assert any(item.name == "scanner" for m in recording.messages("status") for item in m.status)
        for extent, prefix in (("footprint", ""), ("map", "map/")):
            grids = list(recording.terrains(extent))
            occupancies = list(recording.messages(f"{prefix}occupancy"))
            assert len(grids) == len(occupancies) == len(list(recording.messages(f"{prefix}grid_map"))) > 1
            for grid, occupancy in zip(grids, occupancies, strict=True):
                # All have the same stamp: the end of the scan.
                assert grid.stamp == grid.scan_end == read_time(occupancy.header.stamp)
                wanted = message_to_terrain(grid).to_occupancy()
                np.testing.assert_array_equal(occupancy.data.reshape(wanted.shape), wanted)
        assert len(list(recording.messages("scan/points"))) == 2
        assert len(list(recording.messages("map/points"))) == len(list(recording.messages("markers"))) > 1


def test_nothing_that_is_drawn_costs_a_scan(
    bench_with: Callable[..., AbstractContextManager[Bench]],
    robot: RobotModel,
    calibration: gp.Calibration,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    """If messages for viewers cannot be made, log and status say so; grid and frames are published and recorded."""

    def fail(*_: object) -> None:
        raise ValueError("no cloud today")

    monkeypatch.setattr(Scene, "of_points", fail)
    monkeypatch.setattr(Scene, "of_grid", fail)
    path = tmp_path / "walk.mcap"
    recorder = ScanRecorder(path, robot="guara", calibration=calibration, scene=Scene(robot, calibration))
    with recorder, bench_with(recorder) as bench:
        bench.gait.say(0, PausePhase.BEGIN)
        terrain = bench.client.wait_for_step(0, timeout=TIMEOUT, extent="map")
        assert wait_until(lambda: "no cloud today" in recorder.status_item().message)
    assert terrain.step == 0
    assert "failed to record the points of a scan: no cloud today" in caplog.text
    with open_recording(path) as recording:
        assert [scan.is_whole for scan in recording.scans] == [True]
        assert len(list(recording.terrains("map"))) == 1


def test_a_full_disk_costs_the_recording_and_not_the_scan(
    rig: Rig,
    bench_with: Callable[..., AbstractContextManager[Bench]],
    robot: RobotModel,
    calibration: gp.Calibration,
    tmp_path: Path,
) -> None:
    """The scan is published, and the status states what could not be written."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    recorder = ScanRecorder(tmp_path / "walk.mcap", robot="guara", calibration=calibration)
    with bench_with(recorder) as bench:
        resource.setrlimit(resource.RLIMIT_FSIZE, (2_000_000, before[1]))
        try:
            bench.gait.say(0, PausePhase.BEGIN)
            terrain = bench.client.wait_for_step(0, timeout=TIMEOUT)
            reported = "step 0 was only partly recorded: cannot write"
            assert wait_until(lambda: any(reported in item.message for item in bench.status.items()))
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)
    np.testing.assert_array_equal(terrain.hazard, rig.reference.hazard)


def test_a_failing_map_costs_the_map_of_that_pause_and_nothing_else(
    rig: Rig,
    bench_with: Callable[..., AbstractContextManager[Bench]],
    robot: RobotModel,
    calibration: gp.Calibration,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The scan is published and its recording closed, the status names the failure, and later pauses are complete."""
    path = tmp_path / "walk.mcap"
    recorder = ScanRecorder(path, robot="guara", calibration=calibration, jpeg_quality=80)
    with recorder, bench_with(recorder) as bench:
        with monkeypatch.context() as patch:
            patch.setattr(WalkMap, "update", lambda *_, **__: 1 / 0)
            bench.gait.say(0, PausePhase.BEGIN)
            terrain = bench.client.wait_for_step(0, timeout=TIMEOUT)
            assert wait_until(lambda: any("step 0: division by zero" in i.message for i in bench.status.items()))
            with pytest.raises(gp.ScanFailed, match="division by zero"):
                bench.client.request_scan(timeout=TIMEOUT)
            bench.gait.say(0, PausePhase.END)
        np.testing.assert_array_equal(terrain.hazard, rig.reference.hazard)
        assert bench.client.counts("map")["received"] == 0
        for step in (1, 2):
            bench.gait.say(step, PausePhase.BEGIN)
            assert bench.client.wait_for_step(step, timeout=TIMEOUT, extent="map").metadata["scans"] == step
            bench.gait.say(step, PausePhase.END)
        assert not any("division" in item.message for item in bench.status.items())
    with open_recording(path) as recording:
        assert [(scan.step, scan.is_whole) for scan in recording.scans] == [(s, True) for s in (0, 0, 1, 2)]


def test_a_withdrawn_scan_is_not_replayed(
    guara,
    bench_with: Callable[..., AbstractContextManager[Bench]],
    robot: RobotModel,
    calibration: gp.Calibration,
    tmp_path: Path,
) -> None:
    """Replay skips the scan; process and convert refuse it with the reason."""
    both, moved = tmp_path / "both.mcap", tmp_path / "moved.mcap"
    for path, steps in ((both, (0, 1)), (moved, (1,))):
        recorder = ScanRecorder(path, robot="guara", calibration=calibration, jpeg_quality=80)
        with recorder, bench_with(recorder) as bench:
            for step in steps:
                bench.gait.say(step, PausePhase.BEGIN)
                bench.client.wait_for_step(step, timeout=TIMEOUT, extent="map")
                bench.gait.say(step, PausePhase.END, bench.gait.moved() if step else None)
            assert wait_until(lambda: any("step 1: withdrawn" in item.message for item in bench.status.items()))
    first, second = open_scans(both)
    assert not first.withdrawn and "withdrawn: " in second.withdrawn
    said = guara("replay", both, "-o", tmp_path / "grids", "--extent", "footprint")
    assert said.code == 0 and "step 1: withdrawn on the robot, skipped (" in said.out
    assert [path.name for path in (tmp_path / "grids").iterdir()] == ["0000-step0-footprint.npz"]
    out = tmp_path / "out"
    for arguments in (
        ["process", both, "--step", "1", "-o", tmp_path / "t.npz"],
        ["convert", both, out, "--step", "1"],
    ):
        refused = guara(*arguments)
        assert refused.code == 2 and "its grid was withdrawn on the robot" in refused.err
        assert refused.err.count("\n") == 1
    assert "all scans were withdrawn" in guara("replay", moved, "-o", out).err and not out.exists()


def test_a_map_is_confirmed_when_it_is_in_the_journal(
    bench_with: Callable[..., AbstractContextManager[Bench]],
    robot: RobotModel,
    calibration: gp.Calibration,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Even if joints confirm its scan before it is fused, a node killed afterwards does not lose the map."""
    monkeypatch.setattr("guara_perception.app.node.journal.CONFIRM_S", 60.0)
    may_write, fuse, write = threading.Event(), WalkMap.update, Journal._replace

    def fuse_when_confirmed(walk_map: WalkMap, *given: object, **named: object) -> gp.TerrainGrid:
        bench.gait.say(0, PausePhase.HOLD)
        assert wait_until(lambda: bench.node._pause.still_until > named["time"])
        return fuse(walk_map, *given, **named)

    def write_when_told(journal: Journal, *given: object) -> None:
        assert may_write.wait(60.0)
        write(journal, *given)

    monkeypatch.setattr(WalkMap, "update", fuse_when_confirmed)
    monkeypatch.setattr(Journal, "_replace", write_when_told)
    journal = Journal(tmp_path, robot, Seal.of("guara", robot, calibration))
    with journal, bench_with(journal=journal) as bench:
        bench.gait.say(0, PausePhase.BEGIN)
        assert bench.client.wait_for_step(0, timeout=60.0, extent="map").is_provisional
        may_write.set()
        assert wait_until(lambda: not bench.client.latest(extent="map").is_provisional)
        assert journal.item().values["written"] == "1"
