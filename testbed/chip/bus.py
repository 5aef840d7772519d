"""A bus with the emulated chip on it, and the chip's time as a clock for the drivers."""

from __future__ import annotations

import errno
import threading
from typing import Any

from drivers import timing
from drivers.emulator.bus import Bus, BusError
from drivers.emulator.views import ExposureView
from testbed.bench_board.shutter import Opening
from testbed.chip.chip import Chip

BOOT_TIME = 1.0  # s in which the firmware must have been enumerated
SLICE = 0.001  # s for which another thread may have to wait


class ChipBus(Bus):
    """Bus with a chip in emulated time; thread-safe. A transfer takes emulated time only."""

    def __init__(self, chip: Chip) -> None:
        """Wait until the chip is enumerated.

        Raises:
            BusError: the firmware does not come up.
        """
        self.chip = chip
        self.lock = threading.RLock()
        self._claimed = False
        self.await_device()

    def await_device(self) -> None:
        """Let time pass until the device is there."""
        with self.lock:
            self.chip.run(BOOT_TIME, lambda: self.chip.host.enumerated)
            if not self.chip.host.enumerated:
                raise BusError(errno.ENODEV, "the firmware did not come up on the bus")

    def present(self) -> bool:
        """Return whether the device is on the bus."""
        return self.chip.plugged and self.chip.host.enumerated

    def open(self) -> None:
        """Open the device."""
        self._check()

    def claim(self) -> None:
        """Claim the interface; refused while another holds it."""
        self._check()
        if self._claimed:
            raise BusError(errno.EBUSY, "Resource busy")
        self._claimed = True

    def release(self) -> None:
        """Give the interface back."""
        self._claimed = False

    def control(self, request_type: int, request: int, value: int, index: int, length: int, timeout: float) -> bytes:
        """Make a control transfer to the host."""
        with self.lock:
            self._check()
            host = self.chip.host
            setup = bytes([request_type, request]) + b"".join(
                number.to_bytes(2, "little") for number in (value, index, length)
            )
            answers: list[bytes | BusError] = []
            host.submit(setup, answers.append)
            self.chip.run(timeout, lambda: bool(answers) or self.chip.host is not host or not self.chip.plugged)
            self._check()
            if not answers:
                host.abandon()
                raise BusError(errno.ETIMEDOUT, "Operation timed out")
            answer = answers[0]
            if isinstance(answer, BusError):
                raise answer
            return answer

    def command(self, request_type: int, request: int, value: int, index: int, timeout: float) -> None:
        """Make a control transfer without data from the host."""
        self.control(request_type, request, value, index, 0, timeout)

    def interrupt(self, length: int, timeout: float) -> bytes:
        """Wait for a report."""
        deadline = self.chip.nanos + timeout * 1e9
        while True:
            with self.lock:
                self._check()
                host = self.chip.host
                if not host.reports:
                    host.poll()
                    left = max(0.0, (deadline - self.chip.nanos) / 1e9)
                    self.chip.run(min(left, SLICE), lambda host=host: bool(host.reports or host.halted))  # type: ignore[misc]
                if host.halted:
                    raise BusError(errno.EPIPE, "Pipe error")
                if host.reports:
                    return host.reports.popleft()
                if self.chip.nanos >= deadline:
                    host.wants_report = False
                    raise BusError(errno.ETIMEDOUT, "Operation timed out")

    def exposure(self, start: float, end: float) -> ExposureView:
        """Return what a camera that exposed from `start` to `end` [s] saw of the board."""
        with self.lock:
            return self.chip.exposure(start, end)

    def openings(self, first: int = 0) -> tuple[Opening, ...]:
        """When the shutter of the triggered camera opened and closed [s], from opening number `first` on."""
        with self.lock:
            return tuple(self.chip.world.openings[first:])

    def _check(self) -> None:
        if not self.present():
            raise BusError(errno.ENODEV, "No such device (it may have been disconnected)")


class ChipClock:
    """The chip's emulated time for the drivers, see `drivers.timing.on_clock`: to wait is to let the chip run."""

    def __init__(self, bus: ChipBus) -> None:
        """Take the time of the chip on `bus`."""
        self._bus = bus

    def monotonic(self) -> float:
        """Return the emulated time [s]."""
        return self._bus.chip.nanos / 1e9

    def sleep(self, seconds: float) -> None:
        """Let the chip run for this long."""
        with self._bus.lock:
            self._bus.chip.run(seconds)

    def __enter__(self) -> ChipClock:
        """Make the drivers use this clock."""
        self._hold: Any = timing.on_clock(self)
        self._hold.__enter__()
        return self

    def __exit__(self, *failure: Any) -> None:
        """Give the machine's clock back."""
        self._hold.__exit__(*failure)
