"""Emulated USB bus: its transfers are served by an emulated board."""

from __future__ import annotations

import errno
import threading

from drivers import timing
from drivers.board.protocol import REPORT_ENDPOINT, REQUEST_IN, REQUESTS, Request, join_argument
from drivers.emulator.board import EmulatedBoard
from drivers.emulator.descriptors import descriptor

# bmRequestType and bRequest of standard USB requests.
TO_DEVICE, TO_ENDPOINT, FROM_DEVICE = 0x00, 0x02, 0x80
CLEAR_FEATURE, GET_DESCRIPTOR, GET_CONFIGURATION, SET_CONFIGURATION = 1, 6, 8, 9
CLEAR_REPORT_HALT = (TO_ENDPOINT, CLEAR_FEATURE, 0, REPORT_ENDPOINT)
# Interval of checks for a report while the mirror is at rest [s].
REPORT_SLICE = 0.002


class BusError(OSError):
    """Failed operation on the bus, with the `errno` of the corresponding pyusb error."""


class Bus:
    """Bus with a board in this process, as used by the pyusb backend; thread-safe.

    Buses with another board override all methods. A method raises BusError if the operation fails. Timeouts are in [s].
    """

    def __init__(self, board: EmulatedBoard) -> None:
        """Plug `board` into the bus."""
        self._board = board
        self._claimed = False
        self._claim_lock = threading.Lock()

    def present(self) -> bool:
        """Return True: this board is always plugged in."""
        return True

    def open(self) -> None:
        """Open the device; nothing has to be done."""

    def claim(self) -> None:
        """Claim the interface; BusError if it is already claimed."""
        with self._claim_lock:
            if self._claimed:
                raise BusError(errno.EBUSY, "Resource busy")
            self._claimed = True

    def release(self) -> None:
        """Release the interface."""
        with self._claim_lock:
            self._claimed = False

    def control(self, request_type: int, request: int, value: int, index: int, length: int, timeout: float) -> bytes:
        """Make a control transfer with data to the host: a command of the board, or a standard request."""
        command = REQUESTS.get(request) if request_type == REQUEST_IN else None
        if command is None:
            return self._standard(request_type, request, value)[:length]
        return self._serve(command, join_argument(value, index), timeout)[:length]

    def _serve(self, request: Request, argument: int, timeout: float) -> bytes:
        answer = self._board.serve(request, argument)
        if answer is None:
            raise BusError(errno.EPIPE, "Pipe error")
        return answer

    def command(self, request_type: int, request: int, value: int, index: int, timeout: float) -> None:
        """Make a control transfer without data: set the configuration, or clear the halt of the report endpoint."""
        sets_configuration = (request_type, request, value) == (TO_DEVICE, SET_CONFIGURATION, 1)
        if not sets_configuration and (request_type, request, value, index) != CLEAR_REPORT_HALT:
            raise BusError(errno.EPIPE, "Pipe error")

    def interrupt(self, length: int, timeout: float) -> bytes:
        """Wait for the next report, and return it; BusError after `timeout` [s]."""
        deadline = timing.monotonic() + timeout
        while True:
            report = self._next_report()
            if report is not None:
                return report
            now = timing.monotonic()
            if now >= deadline:
                raise BusError(errno.ETIMEDOUT, "Operation timed out")
            motion_left = self._board.still_at() - self._board.clock()
            timing.sleep(min(motion_left if motion_left > 0 else REPORT_SLICE, deadline - now))

    def _next_report(self) -> bytes | None:
        return self._board.next_report()

    def _standard(self, request_type: int, request: int, value: int) -> bytes:
        answer = None
        if (request_type, request) == (FROM_DEVICE, GET_DESCRIPTOR):
            answer = descriptor(value >> 8, value & 0xFF, self._board.config.serial)
        elif (request_type, request) == (FROM_DEVICE, GET_CONFIGURATION):
            answer = b"\x01"
        if answer is None:
            raise BusError(errno.EPIPE, "Pipe error")
        return answer
