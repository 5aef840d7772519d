"""devices.toml: round trip, refusal of invalid fields by name, and user-defined camera classes."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

import guara_perception as gp
from drivers import Board, Camera, CameraSettings, OpenCvCamera
from guara_perception.app.devices_file import Devices, devices_of, load_devices, save_devices
from guara_perception.app.main import run
from guara_perception.app.node.devices import rangefinder_of
from guara_perception.app.options import DeviceOptions

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
    """User-defined module on the Python path."""
    (tmp_path / "my_cameras.py").write_text(OWN)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "my_cameras", raising=False)
    return "my_cameras"


@pytest.mark.parametrize(("camera", "identity"), [(None, "mine"), ("", "mine"), ("1", "")])
def test_the_identity_belongs_to_the_camera_of_the_file(tmp_path: Path, camera: str | None, identity: str) -> None:
    path = tmp_path / "devices.toml"
    save_devices(Devices("0", identity="mine"), path)
    found = devices_of(DeviceOptions(devices=path, camera=camera))
    assert (found.source, found.identity) == (camera or "0", identity)


@pytest.mark.parametrize(
    "devices",
    [
        Devices(),
        Devices(source='v4l2src device="/dev/video2" ! appsink', fps=120.0),
        Devices("1", (1280, 1024), 30.0, 0.0123456789, {"exposure": 0.004, "gamma": 100.0}, {"vendor_id": 0x1209}),
        Devices(identity="OV9281 (1bcf:0b09), serial 7"),
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
        ('format = "guara-devices/1"\n[camera]\nsource = "0"\nexposure = 8', "1.0 s (0.008 for 8 ms)"),
        ('format = "guara-devices/1"\n[camera]\nsource = "0"\nsize = [1, 2]', "camera.size is [1, 2]; allowed: 64"),
        ('format = "guara-devices/1"\n[camera]\nsource = "0"\n[board]\nvendor_id = 70000', "board.vendor_id is 70000"),
        ("format = ", "not valid TOML"),
        ("format = guara-devices/1", "(at line 1, column 10); text needs quotes"),
        ("a = " + "[" * 20_000, "not valid TOML"),
        ("#" * 100_000, "has more than 65536 bytes"),
    ],
)
def test_wrong_files_are_refused_by_field(tmp_path: Path, text: str, reported: str):
    """File, field, given value and what is allowed."""
    (tmp_path / "devices.toml").write_text(text)
    with pytest.raises(gp.FileFormatError) as error:
        load_devices(tmp_path / "devices.toml")
    assert reported in str(error.value) and "devices.toml" in str(error.value)


def test_no_file_says_who_writes_one(tmp_path: Path):
    """The message names `guara record`."""
    with pytest.raises(gp.MissingFile, match="no such file; `guara record` writes one"):
        load_devices(tmp_path / "devices.toml")


def test_cameras_of_every_kind_are_made(own_camera: str):
    """Numbers and paths use OpenCV, classes are imported from their module; the measured lag is set in both cases."""
    assert isinstance(Devices("0").camera(), OpenCvCamera)
    made = Devices(f"{own_camera}:Mine", lag=0.02).camera()
    assert isinstance(made, Camera) and made.name == "mine" and made.lag == 0.02


@pytest.mark.parametrize(
    ("name", "reported"),
    [
        ("NotOne", "is not a drivers.Camera: derive the class from it"),
        ("Missing", "cannot be created"),
        ("WantsMore", "cannot be created"),
    ],
)
def test_classes_that_are_no_cameras_are_refused(own_camera: str, name: str, reported: str):
    """One line with the reason."""
    with pytest.raises(gp.InvalidInput, match=reported):
        Devices(f"{own_camera}:{name}").camera()


@pytest.fixture
def devices_toml(tmp_path: Path) -> Path:
    """Devices whose classes are in a file beside devices.toml, which is not on the Python path."""
    folder = tmp_path / "rig"
    folder.mkdir()
    (folder / f"{tmp_path.name}_own.py").write_text(
        "from drivers import LaserBoard\n"
        "from drivers.cameras.replay_camera import ReplayCamera\n"
        "from drivers.emulator import EmulatedBoard, emulated_backend\n"
        "class Eye(ReplayCamera):\n"
        "    def __init__(self):\n        super().__init__([])\n"
        "class Arm(LaserBoard):\n"
        "    def __init__(self):\n        super().__init__(backend=emulated_backend(EmulatedBoard()))\n"
        "class Neither:\n    pass\n"
    )
    path = folder / "devices.toml"
    path.write_text(
        f'format = "guara-devices/1"\n[camera]\nsource = "{tmp_path.name}_own:Eye"\n'
        f'[board]\nsource = "{tmp_path.name}_own:Arm"\n'
    )
    return path


def test_classes_beside_devices_toml_are_found(devices_toml: Path, capsys: pytest.CaptureFixture[str]):
    """User-defined camera and board, found by every command with --devices; saving the file keeps them."""
    before = list(sys.path)
    devices = load_devices(devices_toml)
    assert type(devices.camera()).__name__ == "Eye"
    board = devices.laser_board()
    assert type(board).__name__ == "Arm" and isinstance(board, Board)
    assert sys.path == before
    save_devices(devices, devices_toml)
    assert load_devices(devices_toml) == devices
    assert run(["doctor", "--devices", str(devices_toml), "--only", "board"]) == 0
    assert "degrees per step" in capsys.readouterr().out


def test_classes_that_are_no_boards_are_refused(devices_toml: Path):
    """One line with the reason and the searched folders; USB ids belong to the board of the protocol only."""
    text = devices_toml.read_text()
    for name, reported in (
        (f"{devices_toml.parents[1].name}_own:Neither", "is not a drivers.Board: derive the class from it"),
        (f"{devices_toml.parents[1].name}_own:Absent", "cannot be created: .*no attribute 'Absent'"),
        (
            "nowhere_at_all:Arm",
            f"No module named 'nowhere_at_all': it is not on .*PYTHONPATH.* nor in {devices_toml.parent}",
        ),
    ):
        board = text[: text.index("[board]")] + f'[board]\nsource = "{name}"\n'
        devices_toml.write_text(board)
        with pytest.raises(gp.InvalidInput, match=reported):
            load_devices(devices_toml).laser_board()
    devices_toml.write_text(text + "vendor_id = 7\n")
    with pytest.raises(gp.FileFormatError, match="is a class of your own: leave out vendor_id"):
        load_devices(devices_toml)


def test_settings_are_locked_when_the_camera_is_opened(monkeypatch: pytest.MonkeyPatch, own_camera: str):
    """Locked before the first frame; without settings, the camera is not changed."""
    locked: list[CameraSettings] = []
    for settings in ({"exposure": 0.004, "gain": 2.0}, {}):
        rangefinder = rangefinder_of(Devices(f"{own_camera}:Mine", settings=settings))
        monkeypatch.setattr(type(rangefinder.camera), "lock", lambda self, given: locked.append(given))
        monkeypatch.setattr(type(rangefinder.board), "__enter__", lambda self: self)
        monkeypatch.setattr(type(rangefinder.board), "__exit__", lambda self, *args: None)
        with rangefinder:
            pass
    assert locked == [CameraSettings(exposure=0.004, gain=2.0)]
