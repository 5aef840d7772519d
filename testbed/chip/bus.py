"""USB bus of the emulated chip, and the chip's emulated time as a clock for the drivers."""

from __future__ import annotations

import errno
import threading
from typing import Any

from drivers import timing
from drivers.emulator.bus import Bus, BusError
from drivers.emulator.views import ExposureView
from testbed.bench_board.shutter import Opening
from testbed.chip.chip import Chip

# Longest time until the firmware is enumerated [s].
BOOT_TIME = 1.0
# Longest emulated time for which a waiting transfer holds the lock [s].
SLICE = 0.001


class ChipBus(Bus):
    """Bus of a chip in emulated time; thread-safe. Transfers take only emulated time."""

    def __init__(self, chip: Chip) -> None:
        """Wait until the chip is enumerated.

        Raises:
            BusError: the firmware is not enumerated in time.
        """
        self.chip = chip
        self.lock = threading.RLock()
        self._claimed = False
        self.await_device()

    def await_device(self) -> None:
        """Run the chip until the device is enumerated."""
        with self.lock:
            self.chip.run(BOOT_TIME, lambda: self.chip.host.enumerated)
            if not self.chip.host.enumerated:
                raise BusError(errno.ENODEV, "the firmware did not come up on the bus")

    def present(self) -> bool:
        """True while the device is on the bus."""
        return self.chip.plugged and self.chip.host.enumerated

    def open(self) -> None:
        """Open the device."""
        self._check()

    def claim(self) -> None:
        """Claim the interface; BusError if it is claimed already."""
        self._check()
        if self._claimed:
            raise BusError(errno.EBUSY, "Resource busy")
        self._claimed = True

    def release(self) -> None:
        """Release the interface."""
        self._claimed = False

    def control(self, request_type: int, request: int, value: int, index: int, length: int, timeout: float) -> bytes:
        """Make a control transfer that returns data."""
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
        """Make a control transfer without data."""
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
        """Return the state of laser and mirror during an exposure from `start` to `end` [s]."""
        with self.lock:
            return self.chip.exposure(start, end)

    def openings(self, first: int = 0) -> tuple[Opening, ...]:
        """Openings (start, end) of the triggered camera's shutter [s], from number `first` on."""
        with self.lock:
            return tuple(self.chip.world.openings[first:])

    def _check(self) -> None:
        if not self.present():
            raise BusError(errno.ENODEV, "No such device (it may have been disconnected)")


class ChipClock:
    """Clock for the drivers (`drivers.timing.on_clock`) that shows the chip's emulated time; sleeping runs the chip."""

    def __init__(self, bus: ChipBus) -> None:
        """Create a clock of the chip on `bus`."""
        self._bus = bus

    def monotonic(self) -> float:
        """Return the emulated time [s]."""
        return self._bus.chip.nanos / 1e9

    def sleep(self, seconds: float) -> None:
        """Run the chip for this time."""
        with self._bus.lock:
            self._bus.chip.run(seconds)

    def __enter__(self) -> ChipClock:
        """Make the drivers use this clock."""
        self._hold: Any = timing.on_clock(self)
        self._hold.__enter__()
        return self

    def __exit__(self, *failure: Any) -> None:
        """Restore the machine's clock."""
        self._hold.__exit__(*failure)
