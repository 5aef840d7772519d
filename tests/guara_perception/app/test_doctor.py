"""`guara doctor`: each check in its good and its bad case, and the exit code."""

import dataclasses
import shutil
import socket
from datetime import UTC, datetime, timedelta
from pathlib import Path

import cv2
import numpy as np
import pytest

import guara_perception as gp
from guara_perception.app import doctor
from guara_perception.app.devices_file import Devices, save_devices
from guara_perception.app.doctor import FAIL, OK, WARN, attempt
from guara_perception.app.main import run
from testbed.altered_robot import altered_guara


def test_missing_devices_are_named_with_the_remedy() -> None:
    """Without board and camera, both checks name what to look at."""
    board = attempt(doctor.check_board, Devices())
    camera = attempt(doctor.check_camera, Devices(source="/dev/no-such-camera"))
    assert (board.level, camera.level) == (FAIL, FAIL)
    assert "cable" in board.message and "check path" in camera.message


def test_a_file_can_stand_in_for_a_camera(tmp_path: Path) -> None:
    """An image sequence opens, and its size is reported."""
    cv2.imwrite(str(tmp_path / "frame_000.png"), np.zeros((120, 160, 3), np.uint8))
    finding = attempt(doctor.check_camera, Devices(source=str(tmp_path / "frame_%03d.png")))
    assert (finding.level, "160x120" in finding.message) == (OK, True)


def test_usb_backend_comes_with_the_package() -> None:
    """libusb needs no system library."""
    assert attempt(doctor.check_usb).level == OK


def test_a_taken_port_is_reported(free_endpoint: str) -> None:
    """A free port, a port in use, and an invalid endpoint."""
    assert attempt(doctor.check_endpoint, free_endpoint).level == OK
    host, port = free_endpoint.removeprefix("tcp/").split(":")
    with socket.socket() as taken:
        taken.bind((host, int(port)))
        taken.listen()
        finding = attempt(doctor.check_endpoint, free_endpoint)
    assert finding.level == FAIL and "stop the node that uses it, or choose another endpoint" in finding.message
    assert attempt(doctor.check_endpoint, "nonsense").level == FAIL


def test_an_address_of_another_machine_is_not_called_in_use() -> None:
    """Such an address is reserved for documentation, so no machine has it."""
    finding = attempt(doctor.check_endpoint, "tcp/192.0.2.1:7447")
    assert finding.level == FAIL and "--listen" in finding.message and "stop the node" not in finding.message


@pytest.mark.parametrize(
    ("changes", "level", "said"),
    [
        ({}, OK, "good"),
        ({"created": (datetime.now(UTC) - timedelta(days=45)).isoformat()}, WARN, "45 days old"),
        ({"created": "once"}, WARN, "unknown age"),
        ({"quality": {"verdict": "refused", "reasons": ["wrong board"]}}, FAIL, "wrong board"),
        ({"quality": {"verdict": "unknown", "reasons": []}}, WARN, "unknown"),
    ],
)
def test_calibration_is_judged_by_verdict_and_age(
    calibration: gp.Calibration, changes: dict[str, object], level: str, said: str
) -> None:
    """Good and recent is ok; old, unknown and refused are distinguished."""
    fresh = {"created": datetime.now(UTC).isoformat()}
    finding = doctor.judge_calibration(dataclasses.replace(calibration, **{**fresh, **changes}))  # type: ignore[arg-type]
    assert finding.level == level and said in finding.message


def test_calibration_that_is_not_there_is_reported(tmp_path: Path) -> None:
    """No calibration is a warning with the remedy, a missing file a failure."""
    assert attempt(doctor.check_calibration, None, Devices()).level == WARN
    assert attempt(doctor.check_calibration, tmp_path / "none.json", Devices()).level == FAIL


def test_calibration_of_another_camera_than_that_of_the_devices_is_reported(
    calibration: gp.Calibration, tmp_path: Path
) -> None:
    """The message names both cameras and the remedy."""
    camera = dataclasses.replace(calibration.camera, identity="A, serial 1")
    gp.save_calibration(dataclasses.replace(calibration, camera=camera), tmp_path / "calibration.json")
    finding = attempt(doctor.check_calibration, tmp_path / "calibration.json", Devices(identity="A, serial 2"))
    assert finding.level == FAIL
    assert "camera 'A, serial 2', but the calibrated camera is 'A, serial 1'" in finding.message


@pytest.mark.slow
def test_drift_is_checked_on_a_scan(data: Path, calibration: gp.Calibration, tmp_path: Path) -> None:
    """The true calibration holds; one with the camera a centimetre lower does not."""
    scan = data / "scans" / "paper"
    gp.save_calibration(calibration, tmp_path / "true.json")
    assert attempt(doctor.check_scan_drift, tmp_path / "true.json", scan).level == OK
    mount = calibration.transform_camera_to_base.copy()
    mount[2, 3] -= 0.01
    gp.save_calibration(dataclasses.replace(calibration, transform_camera_to_base=mount), tmp_path / "moved.json")
    finding = attempt(doctor.check_scan_drift, tmp_path / "moved.json", scan)
    assert finding.level == WARN and "calibrate again" in finding.message
    lens = dataclasses.replace(calibration.camera, distortion=calibration.camera.distortion + (0.05, 0, 0, 0, 0))
    gp.save_calibration(dataclasses.replace(calibration, camera=lens), tmp_path / "other.json")
    finding = attempt(doctor.check_scan_drift, tmp_path / "other.json", scan)
    assert finding.level == WARN and "the calibration belongs to another camera or mount" in finding.message
    copied = shutil.copytree(scan, tmp_path / "scan")
    (copied / "scan.json").write_text((scan / "scan.json").read_text().replace('"robot": "guara"', '"robot": "mine"'))
    robot = altered_guara(tmp_path, ('name = "guara"', 'name = "mine"'))
    for kind, suffix in (("urdf", "urdf"), ("srdf", "srdf")):
        text = (robot / kind / f"guara.{suffix}").read_text().replace('<robot name="guara"', '<robot name="mine"')
        (robot / kind / f"mine.{suffix}").write_text(text)
    gp.save_calibration(dataclasses.replace(calibration, robot="mine"), tmp_path / "mine.json")
    finding = attempt(doctor.check_scan_drift, tmp_path / "mine.json", copied)
    assert finding.level == FAIL and "give the path of a folder with a robot.toml" in finding.message
    assert attempt(doctor.check_scan_drift, tmp_path / "mine.json", copied, str(robot)).level == OK
    assert "not checked" in attempt(doctor.check_scan_drift, None, None).message
    assert attempt(doctor.check_scan_drift, tmp_path / "true.json", tmp_path / "none").level == FAIL


def test_disk_and_speed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Room for recordings, and time per stripe; both can warn."""
    assert attempt(doctor.check_disk, tmp_path).level in (OK, WARN)
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: shutil._ntuple_diskusage(10, 9, 1))
    assert attempt(doctor.check_disk, tmp_path).level == WARN
    assert "ms per stripe" in attempt(doctor.check_speed).message
    monkeypatch.setattr(doctor, "STRIPE_SECONDS", 0.0)
    assert attempt(doctor.check_speed).level == WARN


def test_exit_code_says_whether_something_must_be_mended(
    calibration_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """0 if all selected checks pass, 1 if one fails, 2 for an unknown check."""
    assert run(["doctor", "--only", "usb", "--only", "calibration", "-c", str(calibration_file)]) == 0
    assert "calibration" in capsys.readouterr().out
    assert run(["doctor", "--only", "board"]) == 1
    assert run(["doctor", "--only", "nonsense"]) == 2
    assert "allowed: usb, board" in capsys.readouterr().err


OWN_CAMERA = """
import dataclasses
import time

import numpy as np

from drivers import Camera, Frame
from drivers.errors import CameraSettingRefused


class Own(Camera):
    name = "own"
    fps = 30.0

    def open(self): ...
    def close(self): ...
    def flush(self): ...

    def lock(self, settings):
        if settings.exposure > 0.5:
            raise CameraSettingRefused("own: exposure is locked at 0.5 s at the most")
        return settings

    def grab(self, timeout):
        now = time.monotonic()
        return Frame(np.full((64, 96, 3), 9, np.uint8), 0, now)
"""


def test_the_file_of_devices_is_checked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Camera and size of devices.toml are used, settings are locked and read back; a rejected setting is a failure."""
    (tmp_path / "own_of_doctor.py").write_text(OWN_CAMERA)
    monkeypatch.syspath_prepend(str(tmp_path))
    devices = Devices("own_of_doctor:Own", (96, 64), settings={"exposure": 0.004})
    finding = attempt(doctor.check_camera, devices)
    assert finding.level == OK and "delivers 96x64 px; exposure locked at 0.004" in finding.message
    other = attempt(doctor.check_camera, dataclasses.replace(devices, size=(640, 512)))
    assert other.level == FAIL and "devices.toml says 640x512" in other.message
    refused = attempt(doctor.check_camera, dataclasses.replace(devices, settings={"exposure": 0.6}))
    assert refused.level == FAIL and "exposure is locked at 0.5 s at the most" in refused.message
    save_devices(dataclasses.replace(devices, settings={"exposure": 0.6}), tmp_path / "devices.toml")
    assert run(["doctor", "--devices", str(tmp_path / "devices.toml"), "--only", "camera"]) == 1
    save_devices(devices, tmp_path / "devices.toml")
    assert run(["doctor", "--devices", str(tmp_path / "devices.toml"), "--only", "camera"]) == 0
