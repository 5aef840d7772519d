"""Assignment of frames to commands, and counts from the frame counter."""

import pytest

from drivers import AcquireOptions, Camera, CameraSettings, Frame, LaserBoard
from drivers.errors import CameraTimeout
from drivers.sweep.frame_grabber import FrameGrabber
from drivers.sweep.stripe_worker import ScanStopped


class Script(Camera):
    """Camera that plays (counter, stamp) pairs; None is a time-out."""

    def __init__(self, *frames: tuple[int, float] | None) -> None:
        self.frames = list(frames)
        self.lag = 0.02
        self.flushed = 0

    def open(self) -> None:
        """Do nothing."""

    def close(self) -> None:
        """Do nothing."""

    def lock(self, settings: CameraSettings) -> CameraSettings:
        return settings

    def grab(self, timeout: float) -> Frame:
        item = self.frames.pop(0) if self.frames else None
        if item is None:
            raise CameraTimeout("nothing")
        return Frame(None, *item)  # type: ignore[arg-type]

    def flush(self) -> None:
        self.flushed += 1


@pytest.fixture
def grabber_of(board: LaserBoard):
    def make(camera: Camera, check=lambda: None, **changes: object) -> FrameGrabber:
        return FrameGrabber(camera, board, AcquireOptions(**{"frame_timeout": 0.05} | changes), check)

    return make


NOW = 1e9  # Far in the future of the monotonic clock, so that every missing frame counts as expected.


def test_a_frame_must_begin_after_the_command(grabber_of) -> None:
    """Stamp minus lag decides, exactly at the limit."""
    grabber = grabber_of(Script((1, NOW), (2, NOW + 0.0199), (3, NOW + 0.0201)))
    assert grabber.after(NOW).counter == 3
    assert (grabber.used, grabber.skipped) == (1, 2)


def test_unknown_lag_throws_frames_away(grabber_of) -> None:
    """Two frames that arrive after the command are dropped; one from before is not counted among them."""
    camera = Script(*[(number, NOW + number) for number in range(-1, 6)])
    camera.lag = None
    grabber = grabber_of(camera, flush_frames=2)
    assert grabber.after(NOW).counter == 2
    assert grabber.skipped == 3


def test_gaps_and_repetitions_are_counted(grabber_of) -> None:
    """The camera's counter reveals them."""
    grabber = grabber_of(Script((1, NOW), (1, NOW), (0, NOW), (5, NOW + 4), (6, NOW + 5)))
    taken = [grabber.after(0.0).counter for _ in range(3)]
    assert taken == [1, 5, 6]
    assert (grabber.dropped, grabber.repeated) == (3, 2)


def test_frames_missed_while_nobody_asked_are_not_dropped(grabber_of) -> None:
    """A camera runs on while the mirror turns; only frames that were due during a grab count."""
    grabber = grabber_of(Script((1, 10.0), (9, 11.0)))
    grabber.after(0.0)
    grabber.after(0.0)
    assert grabber.dropped == 0


def test_restart_forgets_the_counting(grabber_of) -> None:
    """After a restart, a gap is not counted."""
    camera = Script((1, NOW), (90, NOW + 1))
    grabber = grabber_of(camera)
    grabber.after(0.0)
    grabber.restart()
    grabber.after(0.0)
    assert grabber.dropped == 0 and camera.flushed == 1


def test_no_frame_in_time_is_none(grabber_of) -> None:
    """Single time-outs of the camera do not count until the whole time is over."""
    assert grabber_of(Script(None, None, (1, NOW))).after(NOW - 1).counter == 1
    assert grabber_of(Script()).after(NOW) is None


def test_the_board_is_asked_while_a_frame_is_awaited(grabber_of, board: LaserBoard) -> None:
    """Each wait without a frame resets the watchdog, so that a slow camera does not turn the laser off."""
    before = board.status().sequence
    grabber_of(Script(None, None, None, (1, NOW))).after(0.0)
    assert board.status().sequence == before + 4


def test_giving_up_comes_from_the_check(grabber_of) -> None:
    """`check` may abort the wait between two grabs."""

    def stop() -> None:
        raise ScanStopped

    with pytest.raises(ScanStopped):
        grabber_of(Script((1, NOW)), stop).after(0.0)
