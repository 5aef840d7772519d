"""`V4l2Camera` with a fake of linuxpy, because there is no video device to test with."""

from __future__ import annotations

import errno
import os
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers import CameraSettings, V4l2Camera
from drivers.cameras import usb_identity
from drivers.cameras import v4l2_camera as module
from drivers.errors import (
    CameraBackendMissing,
    CameraEnded,
    CameraError,
    CameraNotFound,
    CameraNotOpen,
    CameraSettingRefused,
    CameraTimeout,
)


class Control:
    def __init__(self, highest: float) -> None:
        self.highest, self._value = highest, 0

    @property
    def value(self) -> int:
        return self._value

    @value.setter
    def value(self, wanted: int) -> None:
        self._value = min(wanted, self.highest)


class Unplugged:
    @property
    def value(self) -> int:
        raise OSError(errno.ENODEV, "No such device")

    @value.setter
    def value(self, wanted: int) -> None:
        raise OSError(errno.ENODEV, "No such device")


class FakeVideo:
    """Subset of `linuxpy.video.device` that the camera uses; frames are queued by the test."""

    def __init__(self, formats: tuple[str, ...] = ("MJPEG", "YUYV", "GREY"), sizes: tuple = ((8, 4),)) -> None:
        self.formats, self.sizes = formats, sizes
        self.controls = {"auto_exposure": Control(3), "exposure_time_absolute": Control(100), "gain": Control(10)}
        self.queue: list[Any] = []
        self.held = ("MJPEG", *sizes[0])
        self.reader, self.writer = os.pipe()
        self.gone = False
        self.fps = 0.0
        self.is_open = False

    def Device(self, path: str) -> FakeVideo:  # noqa: N802
        if path != "/dev/video0":
            raise FileNotFoundError(errno.ENOENT, "No such file or directory")
        return self

    def VideoCapture(self, device: FakeVideo, size: int) -> Any:  # noqa: N802
        def set_format(width: int, height: int, name: str) -> None:
            self.held = (name, *((width, height) if (width, height) in self.sizes else self.sizes[0]))

        return SimpleNamespace(
            formats=lambda: [SimpleNamespace(pixel_format=SimpleNamespace(name=name)) for name in self.formats],
            get_format=lambda: SimpleNamespace(
                pixel_format=SimpleNamespace(name=self.held[0]),
                width=self.held[1],
                height=self.held[2],
                bytes_per_line=0,
            ),
            set_format=set_format,
            set_fps=lambda fps: setattr(self, "fps", fps),
            open=lambda: None,
            close=lambda: None,
            buffer=SimpleNamespace(raw_read=self.read),
        )

    def open(self) -> None:
        self.is_open = True

    def close(self) -> None:
        self.is_open = False

    def fileno(self) -> int:
        return self.reader

    def push(self, number: int, stamp: float, data: bytes, flags: int = 0) -> None:
        self.queue.append(
            SimpleNamespace(frame_nb=number, timestamp=stamp, data=data, buff=SimpleNamespace(flags=flags))
        )
        os.write(self.writer, b"x")

    def read(self) -> Any:
        if self.gone:
            raise OSError(errno.ENODEV, "No such device")
        os.read(self.reader, 1)
        return self.queue.pop(0)


GREY = bytes(range(32))


def test_frames_carry_the_kernels_numbers_and_stamps() -> None:
    """In order, across the wrap at 32 bits; lost and damaged frames leave gaps."""
    video = FakeVideo()
    with V4l2Camera(video=video, fps=120.0) as camera:
        assert camera.counts_frames and not camera.triggered and video.fps == 120.0
        for number, stamp, flags in (
            (2**32 - 2, 5.0, 0),
            (2**32 - 1, 5.1, 0),
            (1, 5.3, 0),
            (2, 5.4, 0x40),
            (3, 5.5, 0),
        ):
            video.push(number, stamp, GREY, flags)
        frames = [camera.grab(1.0) for _ in range(4)]
        assert [(frame.counter, frame.stamp) for frame in frames] == [(0, 5.0), (1, 5.1), (3, 5.3), (5, 5.5)]
        assert np.array_equal(frames[0].image, np.arange(32).reshape(4, 8)) and not frames[0].image.flags.writeable
        with pytest.raises(CameraTimeout, match=r"no frame within 0\.01 s"):
            camera.grab(0.01)
        video.push(9, 6.0, GREY)
        camera.flush()
        video.push(10, 6.1, GREY)
        assert camera.grab(1.0).stamp == 6.1
    assert not video.is_open
    with pytest.raises(CameraNotOpen):
        camera.grab(0.0)


def test_a_usb_camera_tells_product_ids_and_serial_number(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """From the files beside the video device; empty for a camera that is not on USB."""
    usb = tmp_path / "devices" / "1-2"
    (usb / "1-2:1.0").mkdir(parents=True)
    for name, said in {"product": "OV9281", "idVendor": "1bcf", "idProduct": "0b09", "serial": "00\x0042"}.items():
        (usb / name).write_text(f"{said}\n")
    (tmp_path / "video0").mkdir()
    (tmp_path / "video0" / "device").symlink_to(usb / "1-2:1.0")
    monkeypatch.setattr(usb_identity, "VIDEO_DEVICES", tmp_path)
    with V4l2Camera(video=FakeVideo()) as camera:
        assert camera.identity == "OV9281 (1bcf:0b09), serial 0042"
    (usb / "serial").unlink()
    with V4l2Camera(video=FakeVideo()) as camera:
        assert camera.identity == "OV9281 (1bcf:0b09)"
    (usb / "idProduct").unlink()
    with V4l2Camera(video=FakeVideo()) as camera:
        assert camera.identity == ""


def test_of_yuyv_the_brightness_is_taken() -> None:
    video = FakeVideo(formats=("MJPEG", "YUYV"))
    with V4l2Camera(video=video) as camera:
        video.push(0, 1.0, bytes(range(64)))
        assert np.array_equal(camera.grab(1.0).image, np.arange(0, 64, 2).reshape(4, 8))


def test_settings_are_locked_and_read_back() -> None:
    video = FakeVideo()
    with V4l2Camera(video=video) as camera:
        assert camera.lock(CameraSettings(exposure=0.004, gain=3)) == CameraSettings(exposure=0.004, gain=3)
        assert video.controls["auto_exposure"].value == 1
        with pytest.raises(CameraSettingRefused, match=r"exposure_time_absolute 500, but reports 100"):
            camera.lock(CameraSettings(exposure=0.05))
        with pytest.raises(CameraSettingRefused, match="has no setting gamma"):
            camera.lock(CameraSettings(gamma=1.0))


def test_what_is_held_is_read_back_later() -> None:
    """Controls changed by another program are detected; a disconnected camera raises an error."""
    video = FakeVideo()
    with V4l2Camera(video=video) as camera:
        locked = camera.lock(CameraSettings(exposure=0.004, gain=3))
        assert camera.held(locked).values == {"exposure": pytest.approx(0.004), "gain": 3.0}
        assert camera.held(locked).automatic == ()
        video.controls["auto_exposure"].value = 3
        video.controls["gain"].value = 7
        held = camera.held(locked)
        assert held.automatic == ("exposure",) and held.values["gain"] == 7.0
        video.controls["gain"] = Unplugged()
        with pytest.raises(CameraEnded, match="was disconnected"):
            camera.held(locked)


@pytest.mark.parametrize(
    ("video", "options", "kind", "expected_text"),
    [
        (FakeVideo(("MJPEG",)), {}, CameraSettingRefused, "MJPEG; allowed: GREY or YUYV"),
        (
            FakeVideo(),
            {"size": (640, 480)},
            CameraSettingRefused,
            "asked for 640 x 480 pixels of GREY, but delivers 8 x 4",
        ),
        (FakeVideo(), {"path": "/dev/video9"}, CameraNotFound, "No such file"),
    ],
)
def test_what_is_not_there_is_reported(
    video: FakeVideo, options: dict, kind: type[Exception], expected_text: str
) -> None:
    with pytest.raises(kind, match=expected_text):
        V4l2Camera(video=video, **options).open()
    assert not video.is_open


def test_a_camera_that_is_pulled_out() -> None:
    video = FakeVideo()
    with V4l2Camera(video=video) as camera:
        video.push(0, 1.0, GREY)
        video.gone = True
        with pytest.raises(CameraEnded, match="was disconnected"):
            camera.grab(1.0)
        with pytest.raises(CameraEnded, match="was disconnected"):
            camera.flush()
        video.controls["gain"] = Unplugged()
        with pytest.raises(CameraError, match=r"cannot set gain to 3 \(No such device\)"):
            camera.lock(CameraSettings(gain=3))


def test_damaged_frames_do_not_prolong_the_wait(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each costs 0.4 s of the timeout of 1 s; afterwards only waiting frames are read."""
    video, waits, now = FakeVideo(), [], [5.0]

    def select(readers: list, _w: list, _x: list, timeout: float) -> tuple:
        waits.append(timeout)
        now[0] += 0.4
        return (readers if video.queue else []), [], []

    monkeypatch.setattr(module, "select", SimpleNamespace(select=select))
    monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: now[0]), raising=False)
    with V4l2Camera(video=video) as camera:
        for number in range(4):
            video.push(number, 1.0, GREY, 0x40)
        with pytest.raises(CameraTimeout, match="no frame within 1 s"):
            camera.grab(1.0)
    assert waits == pytest.approx([1.0, 0.6, 0.2, 0.0, 0.0])


def test_an_unknown_pixel_format() -> None:
    with pytest.raises(ValueError, match="pixel format is 'MJPEG', allowed: GREY, YUYV"):
        V4l2Camera(pixel_format="MJPEG")


def test_without_linuxpy_it_says_how_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "linuxpy.video.device", None)
    with pytest.raises(CameraBackendMissing, match="pip install linuxpy"):
        V4l2Camera().open()
