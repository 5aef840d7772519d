"""Source of frames that were exposed after a command had taken effect, with counts of skipped and lost frames."""

from __future__ import annotations

from collections.abc import Callable

from drivers import timing
from drivers.board.board import Board
from drivers.cameras.camera import Camera
from drivers.errors import CameraTimeout
from drivers.frame import Frame
from drivers.sweep.options import AcquireOptions

# Longest wait for a frame before the status is read, which resets the board's watchdog [s].
SLICE = 0.1


class FrameGrabber:
    """Source of the frames of a scan, without those exposed too early.

    Attributes:
        used: number of frames returned.
        skipped: number of frames discarded because they may have been exposed, at least partly, before the command had
            taken effect.
        dropped: number of frames that are missing in the camera's counter and were due while a frame was expected.
        repeated: number of frames whose number had already been seen.
        last_stamp: stamp of the last frame returned [s].
    """

    def __init__(
        self, camera: Camera, board: Board, options: AcquireOptions, check: Callable[[], object] = bool
    ) -> None:
        """Prepare the grabber.

        Args:
            camera: open camera.
            board: open board, whose watchdog is reset while waiting.
            options: options of the scan.
            check: called often; may raise an exception to abort.
        """
        self._camera, self._board, self._options, self._check = camera, board, options, check
        self._before: Frame | None = None
        self.used = self.skipped = self.dropped = self.repeated = 0
        self.last_stamp = timing.monotonic()

    def restart(self) -> None:
        """Discard the frames queued in the camera, and restart the counting of lost frames at the next frame."""
        self._camera.flush()
        self._before = None

    def after(self, ready: float, proved: Callable[[], float] | None = None) -> Frame | None:
        """Return the first frame that was exposed entirely after `ready` [s]; None if none arrives in time.

        If the camera's lag is unknown, `flush_frames` frames that arrive after `ready` are discarded instead.

        Args:
            ready: time at which the command had taken effect [s]; if `proved` is given, the earliest possible such
                time.
            proved: called once, when a candidate frame has arrived; waits until the command has taken effect, and
                returns that time [s].

        Raises:
            CameraEnded: the camera will not deliver any more frames.
            BoardError: the board failed during the wait.
        """
        deadline = timing.monotonic() + self._options.frame_timeout
        lag = self._camera.lag
        to_skip = self._options.flush_frames if lag is None else 0
        while True:
            self._check()
            left = deadline - timing.monotonic()
            if left <= 0:
                return None
            asked = timing.monotonic()
            try:
                frame = self._camera.grab(min(left, SLICE))
            except CameraTimeout:
                self._board.status()
                continue
            if not self._is_new(frame, asked):
                continue
            if proved is not None and frame.stamp - (lag or 0.0) >= ready:
                ready, proved = max(ready, proved()), None
                deadline = timing.monotonic() + self._options.frame_timeout
            if frame.stamp - (lag or 0.0) < ready or to_skip > 0:
                # If the lag is unknown, frames that arrived before the command do not count as flushed.
                to_skip -= 1 if frame.stamp >= ready else 0
                self.skipped += 1
                continue
            self.used += 1
            self.last_stamp = frame.stamp
            return frame

    def _is_new(self, frame: Frame, asked: float) -> bool:
        before = self._before
        if before is not None and frame.counter <= before.counter:
            self.repeated += 1
            return False
        self._before = frame
        if before is not None:
            # Of the missing frames, only those that were due after the request count as lost.
            gap = frame.counter - before.counter
            period = (frame.stamp - before.stamp) / gap
            self.dropped += sum(before.stamp + missed * period > asked for missed in range(1, gap))
        return True
