"""Connection of the driver to an emulated board in this process, without USB."""

from __future__ import annotations

import errno
import math
from collections.abc import Callable
from functools import partial

from drivers import timing
from drivers.board.board_config import BoardConfig
from drivers.board.protocol import Request
from drivers.board.usb_link import UsbLink
from drivers.emulator.board import EmulatedBoard

# Interval of checks for a report while the mirror is at rest [s].
REPORT_SLICE = 0.002


class EmulatedLink(UsbLink):
    """Connection to one emulated board, with the errors of a connection over USB."""

    def __init__(self, board: EmulatedBoard, config: BoardConfig) -> None:
        """Prepare the link to `board`; it is not claimed yet."""
        super().__init__(config)
        self._board = board

    def open(self) -> None:
        """Claim the board; BoardInUse if it is already claimed."""
        if not self._board.claim.acquire(blocking=False):
            raise self._typed(OSError(errno.EBUSY, "Resource busy"), "opening", self._timeout_ms)
        self._device, self.serial = self._board, self._board.config.serial

    def close(self) -> None:
        """Release the board; does nothing if the link is closed."""
        if self._device is not None:
            self._device = None
            self._board.claim.release()

    def request(self, request: Request, argument: int, size: int, timeout: float = math.inf) -> bytes:
        """Execute a command and return the data of its reply; errors as in `UsbLink.request`."""
        self._held()
        answer = self._board.serve(request, argument)
        if answer is None:
            raise self._typed(OSError(errno.EPIPE, "Pipe error"), f"the command {request.name}", self._timeout_ms)
        return answer[:size]

    def read_report(self, timeout: float) -> bytes | None:
        """Wait for a report; return None if none arrives within `timeout` [s]."""
        self._held()
        deadline = timing.monotonic() + timeout
        while (report := self._board.next_report()) is None:
            left = deadline - timing.monotonic()
            if left <= 0:
                return None
            motion_left = self._board.still_at() - self._board.clock()
            timing.sleep(min(motion_left if motion_left > 0 else REPORT_SLICE, left))
        return report


def emulated_backend(board: EmulatedBoard) -> Callable[[BoardConfig], EmulatedLink]:
    """Make the backend with which a `LaserBoard` controls an emulated board."""
    return partial(EmulatedLink, board)
