"""The emulated camera: a free-running camera that sees an emulated board."""

import time

import numpy as np
import pytest

from drivers import CameraSettings, LaserBoard
from drivers.errors import CameraNotOpen, CameraTimeout
from testbed.bench_board import BenchBoard, BenchCamera, CameraFault


def red(image: np.ndarray) -> float:
    return float(image[:, :, 2].max())


def test_frames_are_stamped_one_period_apart(camera: BenchCamera) -> None:
    """Stamps are multiples of the period, whatever the reader does in between."""
    first = camera.grab(5.0)
    time.sleep(0.03)
    later = camera.grab(5.0)
    assert later.counter > first.counter + 1
    assert later.stamp - first.stamp == pytest.approx((later.counter - first.counter) / 300.0)


def test_a_frame_shows_the_board_as_it_was_during_the_exposure(
    camera: BenchCamera, board: LaserBoard, emulated: BenchBoard
) -> None:
    """An exposure that began after the laser was on shows it, one that ended before does not."""
    board.laser_on()
    on = emulated.view().laser_since
    for _ in range(10):
        frame = camera.grab(5.0)
        begin = frame.stamp - 0.0025
        if begin >= on:
            assert red(frame.image) > 150
        elif begin + 0.002 <= on:
            assert red(frame.image) < 60


def test_exposure_is_taken_and_cut_to_the_period(camera: BenchCamera) -> None:
    """`lock` returns the exposure that is set, and `lag` follows."""
    assert camera.lock(CameraSettings(exposure=0.001, gain=3.0)).gain == 3.0
    assert camera.lag == pytest.approx(0.0015)
    assert camera.lock(CameraSettings(exposure=1.0)).exposure == pytest.approx(1 / 300)


def test_flush_gives_a_frame_that_arrives_later(camera: BenchCamera) -> None:
    """The frame after a flush arrives after it."""
    time.sleep(0.02)
    before = time.monotonic()
    camera.flush()
    assert camera.grab(5.0).stamp >= before


class FakeTime:
    """Clock that only advances during sleep, so that no frame is missed on a slow machine."""

    def __init__(self) -> None:
        self.now = 50.0

    def monotonic(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds


@pytest.fixture
def slow_motion(monkeypatch: pytest.MonkeyPatch, scene) -> BenchCamera:
    fake = FakeTime()
    monkeypatch.setattr("drivers.emulator.emulated_camera.timing", fake)
    camera = BenchCamera(BenchBoard(clock=fake.monotonic), scene, fps=30.0, exposure=0.002)
    camera.open()
    return camera


def test_every_frame_comes_once(slow_motion: BenchCamera) -> None:
    """A fast reader gets each frame once, in order."""
    assert [slow_motion.grab(1.0).counter for _ in range(20)] == list(range(20))


def test_dropped_frame_is_a_gap(slow_motion: BenchCamera) -> None:
    """A dropped frame never arrives, and its number is missing."""
    slow_motion.faults.append(CameraFault("drop", 2, 2))
    assert [slow_motion.grab(1.0).counter for _ in range(4)] == [0, 1, 4, 5]


def test_repeated_frame_has_the_old_number(slow_motion: BenchCamera) -> None:
    """Image, number and stamp are repeated."""
    slow_motion.faults.append(CameraFault("repeat", 2))
    frames = [slow_motion.grab(1.0) for _ in range(4)]
    assert [frame.counter for frame in frames] == [0, 1, 1, 3]
    assert frames[2] is frames[1]


def test_frozen_picture_has_a_new_number(slow_motion: BenchCamera) -> None:
    """The counter continues, the image does not change."""
    slow_motion.faults.append(CameraFault("freeze", 1))
    frames = [slow_motion.grab(1.0) for _ in range(3)]
    assert [frame.counter for frame in frames] == [0, 1, 2]
    np.testing.assert_array_equal(frames[1].image, frames[0].image)
    assert not np.array_equal(frames[2].image, frames[1].image)


def test_size_and_exposure_can_change(slow_motion: BenchCamera) -> None:
    """Half the size or twice the light, each for one frame only."""
    slow_motion.faults += [CameraFault("resize", 1), CameraFault("brighten", 2)]
    plain, small, bright, again = (slow_motion.grab(1.0).image for _ in range(4))
    assert small.shape == (plain.shape[0] // 2, plain.shape[1] // 2, 3)
    assert bright.mean() == pytest.approx(2 * plain.mean(), rel=0.1)
    assert again.mean() == pytest.approx(plain.mean(), rel=0.1)


def test_silence_is_a_timeout(camera: BenchCamera) -> None:
    """A camera that delivers nothing raises a time-out."""
    camera.faults.append(CameraFault("silence", 0, 10**6))
    with pytest.raises(CameraTimeout, match=r"no frame within 0\.02 s"):
        camera.grab(0.02)


def test_bad_use_is_refused(emulated: BenchBoard, scene) -> None:
    """Messages for impossible rates, unknown faults and closed cameras state what is allowed."""
    with pytest.raises(ValueError, match="exposure above 0 and at most 1 / fps"):
        BenchCamera(emulated, scene, fps=30.0, exposure=0.1)
    with pytest.raises(ValueError, match="unknown camera fault 'melt', allowed: drop, repeat"):
        CameraFault("melt", 0)
    with pytest.raises(CameraNotOpen):
        BenchCamera(emulated, scene).grab(0.1)
