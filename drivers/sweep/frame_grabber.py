"""Source of frames that were exposed after a command had taken effect, with counts of faults."""

from __future__ import annotations

from collections.abc import Callable

from drivers import timing
from drivers.board.board import Board
from drivers.cameras.camera import Camera
from drivers.errors import CameraTimeout
from drivers.frame import Frame
from drivers.sweep.options import AcquireOptions

# Seconds of one wait for a frame; after each the board is asked for its status, which feeds its watchdog (0.4 s).
SLICE = 0.1


class FrameGrabber:
    """The camera's side of a scan.

    Attributes:
        used: frames that were returned.
        skipped: frames that were exposed, at least partly, before the command.
        dropped: frames missing in the camera's counting that were due while one was awaited.
        repeated: frames that came with a number already seen.
        last_stamp: stamp of the last frame returned [s].
    """

    def __init__(
        self, camera: Camera, board: Board, options: AcquireOptions, check: Callable[[], object] = bool
    ) -> None:
        """Prepare.

        Args:
            camera: an open camera.
            board: an open board, whose watchdog is fed while waiting.
            options: options of the scan.
            check: called often; raises to give up. The default never does.
        """
        self._camera, self._board, self._options, self._check = camera, board, options, check
        self._before: Frame | None = None
        self.used = self.skipped = self.dropped = self.repeated = 0
        self.last_stamp = timing.monotonic()

    def restart(self) -> None:
        """Discard the frames queued in the camera, and restart counting at the next one."""
        self._camera.flush()
        self._before = None

    def after(self, ready: float, proved: Callable[[], float] | None = None) -> Frame | None:
        """Fetch the first frame exposed entirely after `ready` [s]; None on timeout.

        Args:
            ready: when the command had taken effect [s]; if `proved` is given, the earliest instant that is possible.
            proved: called once, when a frame has come that may be the one: waits until the command has taken effect
                and returns since when [s].

        Raises:
            CameraEnded: the camera has no more frames.
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
                # With an unknown lag, a frame that arrived before the command says nothing about the pipeline.
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
            # Gaps before the request are of no interest; missing frames that were due after it count as lost.
            gap = frame.counter - before.counter
            period = (frame.stamp - before.stamp) / gap
            self.dropped += sum(before.stamp + missed * period > asked for missed in range(1, gap))
        return True
