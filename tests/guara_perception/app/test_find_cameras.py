"""`guara doctor --cameras`, the camera checks of `guara doctor`, and sources in devices.toml that Aravis opens."""

import json
from pathlib import Path

import pytest

from drivers import AravisCamera, CameraSettings, OpenCvCamera, V4l2Camera
from guara_perception.app import doctor
from guara_perception.app.devices_file import Devices, load_devices, save_devices
from guara_perception.app.doctor import attempt
from guara_perception.app.main import run
from guara_perception.app.node.devices import rangefinder_of
from guara_perception.exceptions import InvalidInput
from tests.gige import fake_gige


@pytest.fixture
def video_class(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The kernel's list with one webcam."""
    (tmp_path / "video0").mkdir()
    (tmp_path / "video0" / "name").write_text("Imaginary Webcam\n")
    return tmp_path


@pytest.mark.slow
def test_each_camera_is_listed_with_what_it_can_prove(
    video_class: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Frames of a webcam cannot prove a loss; those of a triggered camera are verified by its clock, and its lines are
    listed.
    """
    monkeypatch.setattr(doctor, "VIDEO_CLASS", video_class)
    with fake_gige():
        assert run(["doctor", "--cameras"]) == 0
        printed = capsys.readouterr().out
        assert run(["doctor", "--cameras", "--json"]) == 0
        first, second = map(json.loads, capsys.readouterr().out.splitlines())
        finding = attempt(doctor.check_cameras)
    assert "/dev/video0  Imaginary Webcam (V4L2)\n    runs freely" in printed and "are not detected" in printed
    assert "Aravis Fake (GigEVision, 127.0.0.1)\n    waits for the board's trigger" in printed
    assert "--trigger Line0 or Line1" in printed
    assert (first["source"], second["source"]) == ("/dev/video0", "aravis:Aravis-Fake-GUARA1")
    assert second["lines"] == ["Line0", "Line1"]
    assert finding.level == doctor.OK and "/dev/video0: runs freely" in finding.message
    assert "aravis:Aravis-Fake-GUARA1: waits for the board's trigger" in finding.message


def test_no_camera_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """The message says so, exit 1, and names the kind of camera that could not be searched for."""
    from drivers.cameras import aravis_library

    monkeypatch.setattr(doctor, "VIDEO_CLASS", tmp_path)
    monkeypatch.setitem(__import__("sys").modules, "gi", None)
    monkeypatch.setattr(aravis_library, "SYSTEM_PACKAGES", ("/nowhere",))
    assert run(["doctor", "--cameras"]) == 1
    said = capsys.readouterr().err
    assert "no camera found: check cable" in said and "apt install gir1.2-aravis-0.8" in said
    finding = attempt(doctor.check_cameras)
    assert finding.level == doctor.WARN and "none found; GigE Vision" in finding.message


@pytest.mark.slow
def test_doctor_says_what_the_chosen_camera_proves() -> None:
    """Free-running and triggered; for a missing line, the available ones are listed."""
    with fake_gige() as fake:
        source = f"aravis:{fake.name}"
        # On a busy machine a check may fail once for an unknown reason.
        for _ in range(5):
            free, triggered = (
                attempt(doctor.check_camera, Devices(source)),
                attempt(doctor.check_camera, Devices(source, trigger="Line1")),
            )
            if free.level == triggered.level == doctor.OK:
                break
        wrong = attempt(doctor.check_camera, Devices(source, trigger="Line9"))
    assert free.level == triggered.level == doctor.OK, (free.message, triggered.message)
    assert "320x256 px; it runs freely" in free.message and "detected by the camera's counter" in free.message
    assert "320x256 px; it waits for the board's trigger" in triggered.message
    assert wrong.level == doctor.FAIL and "'Line9'; allowed: Line0, Line1" in wrong.message


def test_a_webcam_cannot_be_triggered() -> None:
    finding = attempt(doctor.check_camera, Devices("/dev/video7", trigger="Line1"))
    assert finding.level == doctor.FAIL and "has no trigger input" in finding.message


def test_a_triggered_camera_makes_the_board_sweep(tmp_path: Path) -> None:
    """Source, lines and format survive the round trip; the laser is on as long as the camera exposes."""
    devices = Devices(
        "aravis:Maker-42",
        trigger="Line1",
        exposure_output="Line2",
        pixel_format="BayerRG8",
        settings={"exposure": 0.003},
    )
    save_devices(devices, tmp_path / "devices.toml")
    assert load_devices(tmp_path / "devices.toml") == devices
    rangefinder = rangefinder_of(devices)
    assert isinstance(rangefinder.camera, AravisCamera) and rangefinder.camera.triggered
    assert rangefinder.options is not None and rangefinder.options.sweep is not None
    assert rangefinder.options.sweep.flash == 0.003
    assert rangefinder.settings == CameraSettings(exposure=0.003)
    free = rangefinder_of(devices, free=True)
    assert not free.camera.triggered and free.options is not None and free.options.sweep is None


def test_v4l2_with_the_kernels_numbers_is_a_source_of_its_own() -> None:
    """The device path alone selects OpenCV."""
    camera = Devices("v4l2:/dev/video3", pixel_format="YUYV", lag=0.02).camera()
    assert isinstance(camera, V4l2Camera) and (camera.name, camera.lag) == ("camera v4l2:/dev/video3", 0.02)
    assert isinstance(Devices("/dev/video3").camera(), OpenCvCamera)
    with pytest.raises(InvalidInput, match="allowed: GREY, YUYV"):
        Devices("v4l2:/dev/video3", pixel_format="Mono8").camera()


def test_without_an_exposure_a_triggered_camera_gets_one() -> None:
    """Otherwise flash and exposure would differ."""
    rangefinder = rangefinder_of(Devices("aravis", trigger="Line1"))
    assert rangefinder.settings == CameraSettings(exposure=0.004)
    assert rangefinder.options is not None and rangefinder.options.sweep is not None
    assert rangefinder.options.sweep.flash == 0.004


@pytest.mark.parametrize(
    ("devices", "expected_text"),
    [
        (Devices("0", trigger="Line1"), "trigger is 'Line1', but camera '0' has no trigger input"),
        (Devices("aravis", trigger="Line1", settings={"exposure": 0.5}), "is on while a triggered camera exposes"),
        (Devices("aravis", pixel_format="RGB8"), "pixel format is 'RGB8', allowed: Mono8"),
    ],
)
def test_what_does_not_go_together_is_refused(devices: Devices, expected_text: str) -> None:
    with pytest.raises(InvalidInput, match=expected_text):
        rangefinder_of(devices)
