"""Client of a board emulated in another process: bus for the pyusb backend, and views of the board's state."""

from __future__ import annotations

import errno
import threading
from typing import Any

from drivers.emulator.backend import EmulatedBackend
from drivers.emulator.bus import Bus, BusError
from drivers.emulator.light import Switching
from drivers.emulator.views import ExposureView
from testbed.bench_board import BoardView
from testbed.bench_board.faults import Fault
from testbed.remote_board.server import encode_fault
from testbed.remote_board.wire import Channel


class _Line:
    """Connection with at most one pending request."""

    def __init__(self, address: str) -> None:
        self._channel = Channel.connect(address)
        self._number = 0
        self._lock = threading.Lock()

    def ask(self, **question: Any) -> dict[str, Any]:
        """Send a request and return the answer; BusError if the remote bus raised it, or if the emulator has ended."""
        with self._lock:
            self._number += 1
            try:
                self._channel.send(question | {"number": self._number})
                answer = self._channel.receive()
                # A signal may have interrupted an earlier request before its answer arrived; skip that answer.
                while answer is not None and answer["number"] != self._number:
                    answer = self._channel.receive()
            except OSError as error:
                raise BusError(errno.ENODEV, "the emulator process is gone") from error
        if answer is None:
            raise BusError(errno.ENODEV, "the emulator process is gone")
        del answer["number"]
        if "errno" in answer:
            raise BusError(answer["errno"], answer["text"])
        return answer

    def close(self) -> None:
        """Close the connection."""
        self._channel.close()


class RemoteBus(Bus):
    """Bus of an emulator process, with separate connections for control and interrupt transfers."""

    def __init__(self, address: str) -> None:
        """Connect; OSError if no emulator listens at `address`."""
        self._control, self._interrupt = _Line(address), _Line(address)

    def present(self) -> bool:
        """True while the board is plugged in."""
        try:
            return bool(self._control.ask(op="present")["value"])
        except BusError:
            return False

    def open(self) -> None:
        """Open the device."""
        self._control.ask(op="open")

    def claim(self) -> None:
        """Claim the interface."""
        self._control.ask(op="claim")

    def release(self) -> None:
        """Release the interface; does nothing if the emulator has ended."""
        try:
            self._control.ask(op="release")
        except BusError:
            return

    def control(self, request_type: int, request: int, value: int, index: int, length: int, timeout: float) -> bytes:
        """Make a control transfer that returns data."""
        setup = [request_type, request, value, index, length]
        return bytes.fromhex(self._control.ask(op="control", setup=setup, timeout=timeout)["data"])

    def command(self, request_type: int, request: int, value: int, index: int, timeout: float) -> None:
        """Make a control transfer without data."""
        self._control.ask(op="command", setup=[request_type, request, value, index], timeout=timeout)

    def interrupt(self, length: int, timeout: float) -> bytes:
        """Read the interrupt endpoint."""
        return bytes.fromhex(self._interrupt.ask(op="interrupt", length=length, timeout=timeout)["data"])

    def close(self) -> None:
        """Close the connections; the board is not affected."""
        self._control.close()
        self._interrupt.close()


class RemoteBoard:
    """Access to a board emulated in another process, with methods as in `BenchBoard`.

    Times are on the monotonic clock, which is common to all processes of a machine.
    """

    def __init__(self, address: str) -> None:
        """Connect; OSError if no emulator listens at `address`."""
        self._line = _Line(address)

    def view(self, at: float | None = None) -> BoardView:
        """Return the state of the board at a time [s]; None = now."""
        return BoardView(**self._line.ask(op="view", at=at))

    def exposure(self, start: float, end: float) -> ExposureView:
        """Return the state of laser and mirror during an exposure from `start` to `end` [s]."""
        return ExposureView(**self._line.ask(op="exposure", start=start, end=end))

    def switchings(self) -> tuple[Switching, ...]:
        """Return the changes of the laser, oldest first."""
        return tuple(Switching(time, on) for time, on in self._line.ask(op="switchings")["value"])

    def inject(self, fault: Fault) -> None:
        """Inject a fault."""
        self._line.ask(op="inject", fault=encode_fault(fault))

    def mend(self) -> None:
        """Remove all injected faults."""
        self._line.ask(op="mend")

    def unplug(self) -> None:
        """Unplug the board."""
        self._line.ask(op="unplug")

    def replug(self) -> None:
        """Plug the board in again."""
        self._line.ask(op="replug")

    def close(self) -> None:
        """Close the connection."""
        self._line.close()


def remote_backend(address: str) -> EmulatedBackend:
    """Create a pyusb backend for the board of the emulator process at `address`.

    Raises:
        OSError: no emulator listens there.
    """
    return EmulatedBackend(RemoteBus(address))
