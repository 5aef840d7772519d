"""devices.toml: what is written is read back; wrong fields are refused by name; a camera class of one's own is made."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

import guara_perception as gp
from drivers import Camera, CameraSettings, OpenCvCamera
from guara_perception.app.devices_file import Devices, load_devices, save_devices
from guara_perception.app.node.devices import rangefinder_of

OWN = """
from drivers import Camera, CameraSettings


class Mine(Camera):
    name = "mine"

    def open(self): ...
    def close(self): ...
    def lock(self, settings): return settings
    def grab(self, timeout): ...
    def flush(self): ...


class NotOne: ...


class WantsMore(Mine):
    def __init__(self, serial): ...
"""


@pytest.fixture
def own_camera(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A module of a user's own on the path."""
    (tmp_path / "my_cameras.py").write_text(OWN)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "my_cameras", raising=False)
    return "my_cameras"


@pytest.mark.parametrize(
    "devices",
    [
        Devices(),
        Devices(source='v4l2src device="/dev/video2" ! appsink', fps=120.0),
        Devices("1", (1280, 1024), 30.0, 0.0123456789, {"exposure": 0.004, "gamma": 100.0}, {"vendor_id": 0x1209}),
        Devices(source="a.b:C", board={"product_id": 3, "serial": 'he said "7"'}),
    ],
)
def test_what_is_written_is_read_back(devices: Devices, tmp_path: Path):
    """Every field, numbers to the last bit."""
    save_devices(devices, tmp_path / "devices.toml")
    assert load_devices(tmp_path / "devices.toml") == devices


@pytest.mark.parametrize(
    ("text", "reported"),
    [
        ("", "format is missing"),
        ('format = "guara-devices/2"\n[camera]\nsource = "0"', "guara-devices/1"),
        ('format = "guara-devices/1"\n[camera]', "camera.source is missing"),
        ('format = "guara-devices/1"\n[camera]\nsource = "0"\nexposur = 1', "unknown exposur; allowed: exposure"),
        ('format = "guara-devices/1"\n[camera]\nsource = "0"\nexposure = 100.0', "camera.exposure is 100"),
        ('format = "guara-devices/1"\n[camera]\nsource = "0"\nsize = [1, 2]', "camera.size is [1, 2], allowed: 64"),
        ('format = "guara-devices/1"\n[camera]\nsource = "0"\n[board]\nvendor_id = 70000', "board.vendor_id is 70000"),
        ("format = ", "no valid TOML"),
        ("a = " + "[" * 20_000, "no valid TOML"),
        ("#" * 100_000, "has 100000 bytes, 65536 are allowed"),
    ],
)
def test_wrong_files_are_refused_by_field(tmp_path: Path, text: str, reported: str):
    """File, field, what was given and what is allowed."""
    (tmp_path / "devices.toml").write_text(text)
    with pytest.raises(gp.FileFormatError) as error:
        load_devices(tmp_path / "devices.toml")
    assert reported in str(error.value) and "devices.toml" in str(error.value)


def test_no_file_says_who_writes_one(tmp_path: Path):
    """The command is named."""
    with pytest.raises(gp.MissingFile, match="no such file; `guara record` writes one"):
        load_devices(tmp_path / "devices.toml")


def test_cameras_of_every_kind_are_made(own_camera: str):
    """Numbers and paths through OpenCV, classes by their module; the measured lag goes with them."""
    assert isinstance(Devices("0").camera(), OpenCvCamera)
    made = Devices(f"{own_camera}:Mine", lag=0.02).camera()
    assert isinstance(made, Camera) and made.name == "mine" and made.lag == 0.02


@pytest.mark.parametrize(
    ("name", "reported"),
    [
        ("NotOne", "is no drivers.Camera: derive the class from it"),
        ("Missing", "cannot be made"),
        ("WantsMore", "cannot be made"),
    ],
)
def test_classes_that_are_no_cameras_are_refused(own_camera: str, name: str, reported: str):
    """One line that says why."""
    with pytest.raises(gp.InvalidInput, match=reported):
        Devices(f"{own_camera}:{name}").camera()


def test_settings_are_locked_when_the_camera_is_opened(monkeypatch: pytest.MonkeyPatch, own_camera: str):
    """As measured, before the first frame; without settings nothing is touched."""
    locked: list[CameraSettings] = []
    for settings in ({"exposure": 0.004, "gain": 2.0}, {}):
        rangefinder = rangefinder_of(Devices(f"{own_camera}:Mine", settings=settings))
        monkeypatch.setattr(type(rangefinder.camera), "lock", lambda self, given: locked.append(given))
        monkeypatch.setattr(type(rangefinder.board), "__enter__", lambda self: self)
        monkeypatch.setattr(type(rangefinder.board), "__exit__", lambda self, *args: None)
        with rangefinder:
            pass
    assert locked == [CameraSettings(exposure=0.004, gain=2.0)]
