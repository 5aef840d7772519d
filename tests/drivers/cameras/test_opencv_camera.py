"""OpenCV cameras with real files and backends, and with a stub of a live device."""

import threading
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from drivers import CameraSettings, OpenCvCamera
from drivers.errors import (
    CameraBackendMissing,
    CameraEnded,
    CameraNotFound,
    CameraNotOpen,
    CameraSettingRefused,
    CameraTimeout,
)

LEVELS = [20, 90, 160, 230]


def image(level: int) -> np.ndarray:
    picture = np.zeros((48, 64, 3), np.uint8)
    picture[:, :, 2] = level
    return picture


@pytest.fixture
def sequence(tmp_path: Path) -> str:
    for number, level in enumerate(LEVELS):
        assert cv2.imwrite(str(tmp_path / f"frame_{number:03d}.png"), image(level))
    return str(tmp_path / "frame_%03d.png")


@pytest.fixture
def video(tmp_path: Path) -> Path:
    path = tmp_path / "scan.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 30.0, (64, 48))
    assert writer.isOpened()
    for level in LEVELS:
        writer.write(image(level))
    writer.release()
    return path


def test_frames_cannot_change_under_another_name_either(sequence: str) -> None:
    """The base array of a frame is read-only too, because a laser-off frame is kept for a whole scan."""
    with OpenCvCamera(sequence) as camera:
        memory: object = camera.grab(1.0).image
        first = memory
        second = camera.grab(1.0).image
    assert isinstance(first, np.ndarray) and not np.shares_memory(first, second)
    while isinstance(memory, np.ndarray):
        assert not memory.flags.writeable
        memory = memory.base
    assert memory is None


def test_image_sequence_is_read_pixel_by_pixel(sequence: str) -> None:
    """PNG files are returned exactly, in order, numbered and read-only, until they end."""
    with OpenCvCamera(sequence) as camera:
        for number, level in enumerate(LEVELS):
            frame = camera.grab(1.0)
            np.testing.assert_array_equal(frame.image, image(level))
            assert frame.counter == number and not frame.image.flags.writeable
        with pytest.raises(CameraEnded, match="no frames left \\(4 were read\\)"):
            camera.grab(1.0)
    assert camera.lag == 0.0


@pytest.mark.parametrize("backend", ["any", "ffmpeg"])
def test_video_file_is_read_whole(video: Path, backend: str) -> None:
    """Every frame of a motion-JPEG file arrives, within the loss of the compression."""
    with OpenCvCamera(video, backend=backend) as camera:
        reds = [float(camera.grab(1.0).image[:, :, 2].mean()) for _ in LEVELS]
        with pytest.raises(CameraEnded):
            camera.grab(1.0)
    np.testing.assert_allclose(reds, LEVELS, atol=6)


def test_reopening_a_file_starts_over(sequence: str) -> None:
    """`open` does nothing if the file is open, and starts over after `close`."""
    camera = OpenCvCamera(sequence, backend="images")
    for _ in range(2):
        with camera:
            camera.open()
            assert camera.grab(1.0).image[0, 0, 2] == LEVELS[0]
    with pytest.raises(CameraNotOpen, match="with camera:"):
        camera.grab(1.0)


def test_flush_of_a_file_loses_nothing(sequence: str) -> None:
    """No frames of a file are waiting."""
    with OpenCvCamera(sequence) as camera:
        camera.flush()
        assert camera.grab(1.0).counter == 0


@pytest.mark.parametrize("source", ["no/such/file.avi", "/dev/video97", 97])
def test_missing_source_is_named(source: str | int) -> None:
    """The message names the source and what to check."""
    with pytest.raises(CameraNotFound, match=f"camera {source} cannot be opened .*group `video`"):
        OpenCvCamera(source).open()


def test_firewire_is_explained() -> None:
    """The message says that this OpenCV has no FireWire backend, and where alternatives are described."""
    if cv2.videoio_registry.hasBackend(cv2.CAP_FIREWIRE):
        pytest.fail("this OpenCV has FireWire: docs/drivers.md and the message must change")
    with pytest.raises(CameraBackendMissing, match=r"no FireWire backend.*docs/drivers\.md"):
        OpenCvCamera(0, backend="firewire").open()
    document = (Path(__file__).resolve().parents[3] / "docs" / "drivers.md").read_text()
    assert "## FireWire cameras" in document


def test_missing_backend_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """An OpenCV without GStreamer raises CameraBackendMissing."""
    monkeypatch.setattr(cv2.videoio_registry, "hasBackend", lambda number: False)
    with pytest.raises(CameraBackendMissing, match="was built without gstreamer"):
        OpenCvCamera("videotestsrc ! appsink", backend="gstreamer").open()


def test_unknown_backend_lists_the_known() -> None:
    """A misspelt backend is rejected at construction."""
    with pytest.raises(ValueError, match="unknown backend 'v4l', allowed: any, v4l2, gstreamer, ffmpeg, images"):
        OpenCvCamera(0, backend="v4l")


def test_a_file_takes_no_settings(sequence: str) -> None:
    """Its frames exist already; empty settings are accepted."""
    with OpenCvCamera(sequence) as camera:
        assert camera.lock(CameraSettings()) == CameraSettings()
        with pytest.raises(CameraSettingRefused, match="is a file"):
            camera.lock(CameraSettings(exposure=0.01))


class LiveCapture:
    """Replacement of cv2.VideoCapture for a live device, which delivers frames on request of the test."""

    size = (64, 48)

    def __init__(self) -> None:
        self.permits = threading.Semaphore(0)
        self.alive = True
        self.count = 0
        self.released = False

    def open(self, source: int, backend: int) -> bool:
        return True

    def grab(self) -> bool:
        while self.alive and not self.released:
            if self.permits.acquire(timeout=0.02):
                self.count += 1
                return True
        return False

    def retrieve(self) -> tuple[bool, np.ndarray]:
        return True, np.full((48, 64), self.count, np.uint8)

    def set(self, prop: int, value: float) -> bool:
        return True

    def get(self, prop: int) -> float:
        return {cv2.CAP_PROP_FRAME_WIDTH: self.size[0], cv2.CAP_PROP_FRAME_HEIGHT: self.size[1]}[prop]

    def release(self) -> None:
        self.released = True


@pytest.fixture
def live(monkeypatch: pytest.MonkeyPatch) -> LiveCapture:
    capture = LiveCapture()
    monkeypatch.setattr(cv2, "VideoCapture", lambda: capture)
    return capture


def test_live_camera_keeps_its_timeout_and_the_newest_frame(live: LiveCapture, eventually) -> None:
    """OpenCV's blocking read does not block the caller, and only the newest frame is returned."""
    with OpenCvCamera(0) as camera:
        assert camera.lag is None
        with pytest.raises(CameraTimeout, match=r"no frame within 0\.05 s"):
            camera.grab(0.05)
        live.permits.release(5)
        eventually(lambda: camera._newest is not None and camera._newest.counter == 4)
        frame = camera.grab(5.0)
        assert frame.counter == 4 and frame.image[0, 0] == 5
        before = time.monotonic()
        live.permits.release()
        assert camera.grab(5.0).stamp >= before
        live.permits.release()
        eventually(lambda: camera._newest is not None)
        camera.flush()
        with pytest.raises(CameraTimeout):
            camera.grab(0.05)
        live.alive = False
    assert live.released


def test_live_camera_that_stops_is_reported(live: LiveCapture) -> None:
    """A disconnected camera raises "stopped delivering", not endless time-outs."""
    with OpenCvCamera(0) as camera:
        live.alive = False
        with pytest.raises(CameraEnded, match="stopped delivering frames: check its cable"):
            camera.grab(5.0)


def test_a_read_that_raises_ends_the_camera(live: LiveCapture, monkeypatch: pytest.MonkeyPatch) -> None:
    """An exception inside OpenCV ends the camera, so that the caller does not wait for a dead thread."""

    def fail() -> tuple[bool, np.ndarray]:
        raise cv2.error("corrupt frame")

    monkeypatch.setattr(live, "retrieve", fail)
    with OpenCvCamera(0) as camera:
        live.permits.release()
        with pytest.raises(CameraEnded, match="stopped delivering"):
            camera.grab(5.0)


def test_a_read_that_never_returns_does_not_keep_the_program(
    live: LiveCapture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Closing gives up on a read that hangs, and does not release the capture."""
    monkeypatch.setattr("drivers.cameras.opencv_camera.LONGEST_READ", 0.05)
    camera = OpenCvCamera(0)
    camera.open()
    camera.close()
    assert not live.released
    live.alive = False
    with pytest.raises(CameraNotOpen):
        camera.grab(0.1)


def test_size_is_read_back(live: LiveCapture) -> None:
    """A camera that delivers another size than requested is rejected and closed."""
    with pytest.raises(CameraSettingRefused, match="asked for 640 x 480 pixels, but delivers 64 x 48"):
        OpenCvCamera(0, size=(640, 480), fps=30.0).open()
    assert live.released
    live.released = False
    with OpenCvCamera(0, size=(64, 48)):
        live.alive = False
