"""A board emulated in another process, as seen from this one: a bus for the backend, and the views of its state."""

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
    """A channel on which one question at a time is asked."""

    def __init__(self, address: str) -> None:
        self._channel = Channel.connect(address)
        self._number = 0
        self._lock = threading.Lock()

    def ask(self, **question: Any) -> dict[str, Any]:
        """The answer; raise BusError when the far bus did, or when the emulator is gone."""
        with self._lock:
            self._number += 1
            try:
                self._channel.send(question | {"number": self._number})
                answer = self._channel.receive()
                # A signal may have cut off an earlier question between asking and hearing; its answer is stale.
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
        """Hang up."""
        self._channel.close()


class RemoteBus(Bus):
    """The bus of an emulator process. Control and interrupt transfers have a line each, as they have a pipe each."""

    def __init__(self, address: str) -> None:
        """Connect; OSError when nobody listens at `address`."""
        self._control, self._interrupt = _Line(address), _Line(address)

    def present(self) -> bool:
        """Whether the board is plugged in."""
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
        """Give the interface back; a vanished emulator has nothing to give back to."""
        try:
            self._control.ask(op="release")
        except BusError:
            return

    def control(self, request_type: int, request: int, value: int, index: int, length: int, timeout: float) -> bytes:
        """Make a control transfer to the host."""
        setup = [request_type, request, value, index, length]
        return bytes.fromhex(self._control.ask(op="control", setup=setup, timeout=timeout)["data"])

    def command(self, request_type: int, request: int, value: int, index: int, timeout: float) -> None:
        """Make a control transfer without data."""
        self._control.ask(op="command", setup=[request_type, request, value, index], timeout=timeout)

    def interrupt(self, length: int, timeout: float) -> bytes:
        """Read the interrupt endpoint."""
        return bytes.fromhex(self._interrupt.ask(op="interrupt", length=length, timeout=timeout)["data"])

    def close(self) -> None:
        """Hang up; the board notices nothing."""
        self._control.close()
        self._interrupt.close()


class RemoteBoard:
    """The state of a board emulated in another process, with the methods of `BenchBoard` that look at it.

    Times are those of the monotonic clock, which all processes of a machine share.
    """

    def __init__(self, address: str) -> None:
        """Connect; OSError when nobody listens at `address`."""
        self._line = _Line(address)

    def view(self, at: float | None = None) -> BoardView:
        """What the board was like at a time [s]; None for now."""
        return BoardView(**self._line.ask(op="view", at=at))

    def exposure(self, start: float, end: float) -> ExposureView:
        """What a camera that exposed from `start` to `end` [s] saw."""
        return ExposureView(**self._line.ask(op="exposure", start=start, end=end))

    def switchings(self) -> tuple[Switching, ...]:
        """When the laser really went on and off, oldest first."""
        return tuple(Switching(time, on) for time, on in self._line.ask(op="switchings")["value"])

    def inject(self, fault: Fault) -> None:
        """Inject a fault."""
        self._line.ask(op="inject", fault=encode_fault(fault))

    def mend(self) -> None:
        """Forget every injected fault."""
        self._line.ask(op="mend")

    def unplug(self) -> None:
        """Pull the plug."""
        self._line.ask(op="unplug")

    def replug(self) -> None:
        """Plug in again."""
        self._line.ask(op="replug")

    def close(self) -> None:
        """Hang up."""
        self._line.close()


def remote_backend(address: str) -> EmulatedBackend:
    """A pyusb backend whose device is the board of the emulator process at `address`.

    Raises:
        OSError: nobody listens there.
    """
    return EmulatedBackend(RemoteBus(address))
