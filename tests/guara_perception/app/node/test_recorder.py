"""The recorder never delays a scan: slow disks, full disks, and scans that were never ended."""

import errno
import os
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.app.files import recording_files
from guara_perception.app.node import recorder as module
from guara_perception.app.node.recorder import ScanRecorder
from guara_perception.app.scene.scene import Scene
from kinematics import RobotModel
from transport import Health, clock
from transport.recording import open_recording, recover_recording

pytestmark = pytest.mark.slow

PATIENCE = 180.0


def _capture(index: int, off: np.ndarray | None = None) -> SimpleNamespace:
    on = np.random.default_rng(index).integers(0, 256, (200, 320), np.uint8)
    return SimpleNamespace(index=index, mirror_angle=0.01 * index, on=on, off=off, dark=None, is_dark_due=False)


def test_a_stalled_disk_holds_nothing_up(
    tmp_path: Path, calibration: gp.Calibration, paper_scan: gp.Scan, monkeypatch: pytest.MonkeyPatch
) -> None:
    """While every write hangs, a whole scan is accepted; when the disk works again, all of it is written."""
    released, hung, write = threading.Event(), threading.Event(), os.write

    def stalled(descriptor: int, data: object) -> int:
        if threading.current_thread().name == "transport-outbox recording":
            hung.set()
            released.wait(PATIENCE)
        return write(descriptor, data)

    monkeypatch.setattr(os, "write", stalled)
    with ScanRecorder(tmp_path / "walk.mcap", robot="guara", calibration=calibration) as recorder:
        off = np.zeros((200, 320), np.uint8)
        for step in (1, 2):
            scan = recorder.begin(step, "standard", paper_scan.stance)
            for index in range(70):
                capture = _capture(index, off)
                scan.add(capture)
                # A camera may reuse its memory.
                capture.on[:] = 0
            scan.finish((), None)
        assert hung.wait(PATIENCE) and not recorder.flush(0.1)
        released.set()
        assert recorder.flush(PATIENCE)
        item = recorder.status_item()
        assert (item.values["recorded"], item.values["lost"]) == ("2", "0")
    with open_recording(tmp_path / "walk.mcap") as recording:
        assert [(scan.step, len(scan.stripes), scan.is_whole) for scan in recording.scans] == [
            (1, 70, True),
            (2, 70, True),
        ]
        last = recording.scans[1].stripes[69]
        np.testing.assert_array_equal(recording.frame(last.on).pixels, _capture(69).on)
        assert len({stripe.off for stripe in recording.scans[1].stripes}) == 1


def test_what_a_slow_disk_costs_is_said(
    tmp_path: Path, calibration: gp.Calibration, paper_scan: gp.Scan, monkeypatch: pytest.MonkeyPatch
) -> None:
    """If the waiting data exceed the memory limit, the recording of the scan ends, and the status names the scan."""
    monkeypatch.setattr(module, "MAXIMUM_WAITING", 100_000)
    with ScanRecorder(tmp_path / "walk.mcap", robot="guara", calibration=calibration) as recorder:
        scan = recorder.begin(7, "standard", paper_scan.stance)
        assert recorder.flush(PATIENCE)
        blocked = threading.Event()
        recorder.post(0, lambda: blocked.wait(PATIENCE))
        for index in range(4):
            scan.add(_capture(index))
        scan.finish((), None)
        blocked.set()
        assert recorder.flush(PATIENCE)
        item = recorder.status_item()
        assert item.values["lost"] == "1" and "step 7" in item.message and "too slow" in item.message


def test_a_scan_that_was_never_ended_does_not_cost_the_next(
    tmp_path: Path, calibration: gp.Calibration, paper_scan: gp.Scan
) -> None:
    """A scan whose processing died leaves no scan open."""
    with ScanRecorder(tmp_path / "walk.mcap", robot="guara", calibration=calibration) as recorder:
        recorder.begin(1, "standard", paper_scan.stance).add(_capture(0))
        second = recorder.begin(2, "standard", paper_scan.stance)
        second.add(_capture(0))
        second.finish((), None)
        assert recorder.flush(PATIENCE)
        assert recorder.status_item().values["recorded"] == "1"
    with open_recording(tmp_path / "walk.mcap") as recording:
        assert [scan.step for scan in recording.scans] == [1, 2]


def test_stripes_have_the_time_of_their_frames(
    tmp_path: Path, calibration: gp.Calibration, paper_scan: gp.Scan
) -> None:
    """A scan that is processed from its recording ends when its last frame arrived, as the grid of the node says."""
    with ScanRecorder(tmp_path / "walk.mcap", robot="guara", calibration=calibration) as recorder:
        scan = recorder.begin(1, "standard", paper_scan.stance)
        scan.add(_capture(0), instant=clock.now() - 60.0)
        added = time.time_ns()
        scan.finish((), None)
        assert recorder.flush(PATIENCE)
    with open_recording(tmp_path / "walk.mcap") as recording:
        assert recording.scans[0].stripes[0].stamp <= added - 60 * 10**9


def _scan(recorder: ScanRecorder, step: int, stance: object, stripes: int = 4) -> None:
    scan = recorder.begin(step, "standard", stance)
    for index in range(stripes):
        scan.add(_capture(index))
    scan.finish((), None)


def _steps(path: Path) -> list[int]:
    """Steps of the complete scans of a file, which also contains calibration, robot and all frames."""
    with gp.open_recording(path) as recording:
        assert recording.calibration is not None and all(len(list(scan.frames())) == 4 for scan in recording.scans)
    with open_recording(path) as messages:
        assert len(list(messages.messages("/robot_description"))) == len(list(messages.messages("/tf_static"))) == 1
        assert all(scan.is_whole for scan in messages.scans)
        return [scan.step for scan in messages.scans]


def test_each_file_of_a_recording_opens_by_itself(
    tmp_path: Path,
    calibration: gp.Calibration,
    robot: RobotModel,
    paper_scan: gp.Scan,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A full file ends before the next scan; after a restart all scans exist once, and the oldest are removed."""
    monkeypatch.setattr(recording_files, "FILE_SIZE", 600_000)

    def recorder(limit: int | None = None) -> ScanRecorder:
        scene = Scene(robot, calibration)
        return ScanRecorder(tmp_path / "walks", robot="guara", calibration=calibration, scene=scene, limit=limit)

    for steps in (range(5), range(5, 9)):
        with recorder() as one:
            for step in steps:
                _scan(one, step, paper_scan.stance)
            assert one.flush(PATIENCE) and one.status_item().level == Health.OK and not one.cut
    files = sorted((tmp_path / "walks").iterdir())
    found = [_steps(path) for path in files]
    assert [step for steps in found for step in steps] == list(range(9))
    assert len(files) == 4 and all(found)
    size = sum(path.stat().st_size for path in files)
    with recorder(size) as one:
        kept = [path for path in files if path.exists()]
        assert 0 < len(kept) < len(files) and kept == files[-len(kept) :]
        for step in range(20, 30):
            _scan(one, step, paper_scan.stance)
            assert one.flush(PATIENCE)
            assert sum(path.stat().st_size for path in (tmp_path / "walks").iterdir()) <= size
    assert _steps(max((tmp_path / "walks").iterdir()))[-1] == 29


def test_a_full_disk_at_a_change_of_files_loses_nothing(
    tmp_path: Path, calibration: gp.Calibration, paper_scan: gp.Scan, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The file continues until all waiting data are written; a full disk at the start does not stop a node."""
    monkeypatch.setattr(recording_files, "FILE_SIZE", 600_000)
    full, write = threading.Event(), os.write

    def on_disk(descriptor: int, data: object) -> int:
        if full.is_set() and len(data) > 1000:  # type: ignore[arg-type]
            raise OSError(errno.ENOSPC, "No space left on device")
        return write(descriptor, data)

    monkeypatch.setattr(os, "write", on_disk)
    full.set()
    with ScanRecorder(tmp_path, robot="guara", calibration=calibration) as recorder:
        for step in range(3):
            _scan(recorder, step, paper_scan.stance, 12)
        assert recorder.flush(PATIENCE)
        item = recorder.status_item()
        assert item.level == Health.ERROR and "No space left" in item.message and item.values["lost"] == "3"
        assert len(list(tmp_path.iterdir())) == 1
        full.clear()
        _scan(recorder, 3, paper_scan.stance)
        assert recorder.flush(PATIENCE) and recorder.status_item().level == Health.OK
    steps = []
    for path in sorted(tmp_path.iterdir()):
        with open_recording(path) as recording:
            assert recording.calibration is not None
            steps += [scan.step for scan in recording.scans if scan.is_whole]
    assert steps == [0, 1, 2, 3] and len(list(tmp_path.iterdir())) == 2


def test_a_folder_that_is_gone_keeps_the_file(
    tmp_path: Path, calibration: gp.Calibration, paper_scan: gp.Scan, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No new file can be created: the scans continue in the old one, and the status states the reason."""
    monkeypatch.setattr(recording_files, "FILE_SIZE", 200_000)
    with ScanRecorder(tmp_path / "walks", robot="guara", calibration=calibration) as recorder:
        (tmp_path / "walks").rename(tmp_path / "away")
        for step in range(3):
            _scan(recorder, step, paper_scan.stance)
        assert recorder.flush(PATIENCE)
        item = recorder.status_item()
        assert item.level == Health.WARN and "no new file" in item.message and item.values["recorded"] == "3"
    with open_recording(tmp_path / "away" / "guara-000001.mcap") as recording:
        assert [scan.step for scan in recording.scans] == [0, 1, 2]


def test_what_was_cut_stays_and_is_named(tmp_path: Path, calibration: gp.Calibration, paper_scan: gp.Scan) -> None:
    """A killed recorder leaves a file that can be recovered; the next recorder starts another file."""
    dead = ScanRecorder(tmp_path / "w.mcap", robot="guara", calibration=calibration)
    _scan(dead, 0, paper_scan.stance)
    assert dead.flush(PATIENCE)
    before = (tmp_path / "w.mcap").read_bytes()
    with ScanRecorder(tmp_path / "w.mcap", robot="guara", calibration=calibration) as recorder:
        assert recorder.path == tmp_path / "w-2.mcap" and recorder.cut == [tmp_path / "w.mcap"]
        _scan(recorder, 1, paper_scan.stance)
    assert (tmp_path / "w.mcap").read_bytes() == before
    assert recover_recording(tmp_path / "w.mcap", tmp_path / "whole.mcap").bytes_lost == 0
    for name, step in (("whole.mcap", 0), ("w-2.mcap", 1)):
        with open_recording(tmp_path / name) as recording:
            assert [(scan.step, scan.is_whole) for scan in recording.scans] == [(step, True)]


def test_a_recording_may_begin_later(
    tmp_path: Path, calibration: gp.Calibration, robot: RobotModel, paper_scan: gp.Scan
) -> None:
    """Frames, grids and range images of earlier pauses are not written, and not counted as lost."""
    scene = Scene(robot, calibration)
    images: list[int] = []
    with ScanRecorder(tmp_path / "w.mcap", robot="guara", calibration=calibration, scene=scene, first=6) as recorder:
        for step in range(9):
            scan = recorder.begin(step, "standard", paper_scan.stance)
            assert (scan is None) == (step < 6)
            recorder.add_range_images(step, lambda step=step: images.append(step) or {})
            if scan is not None:
                scan.add(_capture(0))
                scan.finish((), None)
        assert recorder.flush(PATIENCE)
        assert recorder.status_item().values["recorded"] == "3" and recorder.status_item().values["lost"] == "0"
    with open_recording(tmp_path / "w.mcap") as recording:
        assert [scan.step for scan in recording.scans] == [6, 7, 8] == images
