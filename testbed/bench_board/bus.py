"""USB bus of the bench board, which can be unplugged and whose transfers can fail."""

from __future__ import annotations

import errno
import random

from drivers import timing
from drivers.board.protocol import Request
from drivers.emulator.backend import EmulatedBackend
from drivers.emulator.bus import Bus, BusError
from testbed.bench_board.board import BenchBoard
from testbed.bench_board.faults import Fault, FaultKind

BEFORE = (FaultKind.UNPLUG, FaultKind.STALL, FaultKind.TIMEOUT)
AFTER = (FaultKind.UNPLUG_AFTER, FaultKind.TIMEOUT_AFTER, FaultKind.SHORT_READ, FaultKind.GARBAGE)


class FaultyBus(Bus):
    """Bus in this process, with the faults in the plan of its board; thread-safe."""

    _board: BenchBoard

    def __init__(self, board: BenchBoard) -> None:
        """Plug `board` in."""
        super().__init__(board)
        self._halted = False
        self._noise = random.Random(1)

    def present(self) -> bool:
        """True while the board is plugged in."""
        return self._board.plugged

    def open(self) -> None:
        """Open the device."""
        self._check_plugged()
        if self._board.plan.strike("open", (FaultKind.NO_PERMISSION,)):
            raise BusError(errno.EACCES, "Access denied (insufficient permissions)")

    def claim(self) -> None:
        """Claim the interface, unless it is claimed already."""
        self._check_plugged()
        if not self._claimed and self._board.plan.strike("claim", (FaultKind.BUSY,)):
            raise BusError(errno.EBUSY, "Resource busy")
        super().claim()

    def control(self, request_type: int, request: int, value: int, index: int, length: int, timeout: float) -> bytes:
        """Make a control transfer: a command of the board, or a standard request."""
        self._check_plugged()
        return super().control(request_type, request, value, index, length, timeout)

    def command(self, request_type: int, request: int, value: int, index: int, timeout: float) -> None:
        """Make a control transfer without data: set the configuration, or clear the endpoint's halt."""
        self._check_plugged()
        super().command(request_type, request, value, index, timeout)
        self._halted = False

    def interrupt(self, length: int, timeout: float) -> bytes:
        """Wait for a report. A stalled endpoint stays stalled until its halt is cleared."""
        plan = self._board.plan
        fault = plan.strike("report", BEFORE)
        self._halted = self._halted or (fault is not None and fault.kind is FaultKind.STALL)
        if self._halted:
            raise BusError(errno.EPIPE, "Pipe error")
        self._strike(fault, timeout)
        report = super().interrupt(length, timeout)
        return self._strike(plan.strike("report", AFTER), timeout, report)

    def _serve(self, request: Request, argument: int, timeout: float) -> bytes:
        plan = self._board.plan
        self._strike(plan.strike(request, BEFORE), timeout)
        timing.sleep(self._board.bus_delay)
        answer = super()._serve(request, argument, timeout)
        return self._strike(plan.strike(request, AFTER), timeout, answer)

    def _next_report(self) -> bytes | None:
        self._check_plugged()
        return super()._next_report()

    def _check_plugged(self) -> None:
        if not self._board.plugged:
            raise BusError(errno.ENODEV, "No such device (it may have been disconnected)")

    def _strike(self, fault: Fault | None, timeout: float, answer: bytes = b"") -> bytes:
        """Apply a fault, if any, to a transfer and return its answer."""
        if fault is None:
            return answer
        match fault.kind:
            case FaultKind.UNPLUG | FaultKind.UNPLUG_AFTER:
                self._board.unplug()
                self._check_plugged()
            case FaultKind.STALL:
                raise BusError(errno.EPIPE, "Pipe error")
            case FaultKind.TIMEOUT | FaultKind.TIMEOUT_AFTER:
                timing.sleep(timeout)
                raise BusError(errno.ETIMEDOUT, "Operation timed out")
            case FaultKind.SHORT_READ:
                return answer[: len(answer) // 2]
        return self._noise.randbytes(len(answer))


def bench_backend(*boards: BenchBoard) -> EmulatedBackend:
    """Create a pyusb backend with one bus per board."""
    return EmulatedBackend(*(FaultyBus(board) for board in boards))
