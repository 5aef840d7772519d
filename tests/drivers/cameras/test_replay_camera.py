"""Replay of frames."""

import time

import numpy as np
import pytest

from drivers import CameraSettings, Frame, ReplayCamera
from drivers.errors import CameraEnded, CameraNotOpen, CameraSettingRefused, CameraTimeout

IMAGES = [np.full((4, 6), value, np.uint8) for value in (1, 2, 3)]


def test_frames_come_in_order_numbered_and_end() -> None:
    """No frame is dropped, and the end raises CameraEnded."""
    with ReplayCamera(IMAGES) as camera:
        frames = [camera.grab(0.1) for _ in IMAGES]
        with pytest.raises(CameraEnded, match=r"no frames left \(3 were played\)"):
            camera.grab(0.1)
    assert [frame.counter for frame in frames] == [0, 1, 2]
    assert [int(frame.image[0, 0]) for frame in frames] == [1, 2, 3]
    assert all(a.stamp <= b.stamp for a, b in zip(frames, frames[1:], strict=False))


def test_images_are_read_only() -> None:
    """The reader cannot change replayed frames, and the caller's array stays writable."""
    with ReplayCamera(IMAGES) as camera, pytest.raises(ValueError, match="read-only"):
        camera.grab(0.1).image[0, 0] = 9
    assert IMAGES[0].flags.writeable


def test_a_list_starts_over_when_reopened() -> None:
    """A list can be replayed twice; a generator is exhausted."""
    camera = ReplayCamera(IMAGES)
    for _ in range(2):
        with camera:
            assert camera.grab(0.1).image[0, 0] == 1


def test_frames_keep_their_numbers() -> None:
    """Frames with their own numbers show their gaps."""
    with ReplayCamera([Frame(IMAGES[0], 7, 0.0), Frame(IMAGES[1], 9, 0.1)]) as camera:
        assert [camera.grab(0.1).counter, camera.grab(0.1).counter] == [7, 9]


def test_frame_rate_is_kept() -> None:
    """At 50 frames per second, three frames take at least 60 ms, and a shorter timeout raises an error."""
    with ReplayCamera(IMAGES, fps=50.0) as camera:
        begun = time.monotonic()
        for _ in IMAGES:
            camera.grab(1.0)
        assert time.monotonic() - begun >= 0.058
    with ReplayCamera(IMAGES, fps=0.5) as camera, pytest.raises(CameraTimeout, match=r"no frame within 0\.01 s"):
        camera.grab(0.01)


def test_settings_cannot_be_changed_afterwards() -> None:
    """Replayed frames already have their exposure; empty settings are accepted."""
    with ReplayCamera(IMAGES, name="tape") as camera:
        assert camera.lock(CameraSettings()) == CameraSettings()
        with pytest.raises(CameraSettingRefused, match="tape replays existing frames"):
            camera.lock(CameraSettings(gain=1.0))


def test_closed_camera_and_bad_rate_are_refused() -> None:
    """Both messages say what to do."""
    with pytest.raises(CameraNotOpen, match="with camera:"):
        ReplayCamera(IMAGES).grab(0.1)
    with pytest.raises(ValueError, match="fps is 0; it must be above 0"):
        ReplayCamera(IMAGES, fps=0)
