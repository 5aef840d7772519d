"""The recorder never delays a scan: slow disks, full disks, scans that were never ended."""

import os
import threading
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.app.node import recorder as module
from guara_perception.app.node.recorder import ScanRecorder
from transport.recording import open_recording

pytestmark = pytest.mark.slow

PATIENCE = 180.0


def _capture(index: int, off: np.ndarray | None = None) -> SimpleNamespace:
    on = np.random.default_rng(index).integers(0, 256, (200, 320), np.uint8)
    return SimpleNamespace(index=index, mirror_angle=0.01 * index, on=on, off=off)


def test_a_stalled_disk_holds_nothing_up(
    tmp_path: Path, calibration: gp.Calibration, paper_scan: gp.Scan, monkeypatch: pytest.MonkeyPatch
) -> None:
    """While every write hangs, a whole scan is handed over; when the disk is back all of it is written."""
    released, hung, write = threading.Event(), threading.Event(), os.write

    def stalled(descriptor: int, data: object) -> int:
        if threading.current_thread().name == "guara-recorder":
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
                # A camera may use its memory again.
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
    """When more waits than memory allows, the scan's recording ends there, and the status says which scan it was."""
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
    """A scan whose processing died leaves nothing open."""
    with ScanRecorder(tmp_path / "walk.mcap", robot="guara", calibration=calibration) as recorder:
        recorder.begin(1, "standard", paper_scan.stance).add(_capture(0))
        second = recorder.begin(2, "standard", paper_scan.stance)
        second.add(_capture(0))
        second.finish((), None)
        assert recorder.flush(PATIENCE)
        assert recorder.status_item().values["recorded"] == "1"
    with open_recording(tmp_path / "walk.mcap") as recording:
        assert [scan.step for scan in recording.scans] == [1, 2]
