"""Takes from a camera the first frame exposed after a command had taken effect, and counts what goes wrong."""

from __future__ import annotations

import time
from collections.abc import Callable

from drivers.board import LaserBoard
from drivers.camera import Camera
from drivers.errors import CameraTimeout
from drivers.frame import Frame
from drivers.options import AcquireOptions

_SLICE = 0.2  # s; between two, the board is spoken to, so that its watchdog (0.5 s) is fed while a frame is awaited


class FrameGrabber:
    """The camera's side of a scan.

    Attributes:
        used: frames that were returned.
        skipped: frames exposed, at least in part, before the command.
        dropped: gaps in the camera's counting.
        repeated: frames that came with a number already seen.
        last_stamp: stamp of the last frame returned [s].
    """

    def __init__(self, camera: Camera, board: LaserBoard, options: AcquireOptions, check: Callable[[], None]) -> None:
        """Prepare.

        Args:
            camera: an open camera.
            board: an open board, whose watchdog is fed while waiting.
            options: of the scan.
            check: called often; raises to give up.
        """
        self._camera, self._board, self._options, self._check = camera, board, options, check
        self._counter: int | None = None
        self.used = self.skipped = self.dropped = self.repeated = 0
        self.last_stamp = time.monotonic()

    def restart(self) -> None:
        """Forget what waits in the camera; frames missed until now were not wanted and do not count as dropped."""
        self._camera.flush()
        self._counter = None

    def after(self, ready: float) -> Frame | None:
        """Return the first frame exposed wholly after `ready` [s]; None when none came in time.

        Raises:
            CameraEnded: the camera has no more frames.
        """
        deadline = time.monotonic() + self._options.frame_timeout
        lag = self._camera.lag
        to_skip = self._options.flush_frames if lag is None else 0
        while True:
            self._check()
            left = deadline - time.monotonic()
            if left <= 0:
                return None
            try:
                frame = self._camera.grab(min(left, _SLICE))
            except CameraTimeout:
                self._board.status()
                continue
            if not self._is_new(frame):
                continue
            if frame.stamp - (lag or 0.0) < ready or to_skip > 0:
                # With an unknown lag, a frame that arrived before the command says nothing about the pipeline.
                to_skip -= 1 if frame.stamp >= ready else 0
                self.skipped += 1
                continue
            self.used += 1
            self.last_stamp = frame.stamp
            return frame

    def _is_new(self, frame: Frame) -> bool:
        before, self._counter = self._counter, frame.counter
        if before is None:
            return True
        if frame.counter <= before:
            self._counter = before
            self.repeated += 1
            return False
        self.dropped += frame.counter - before - 1
        return True
