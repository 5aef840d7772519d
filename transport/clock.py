"""Monotonic clock for ages, which keeps running while the machine is suspended."""

from __future__ import annotations

import time

# Linux clock like CLOCK_MONOTONIC that also counts the time for which the machine was suspended.
BOOT_CLOCK = getattr(time, "CLOCK_BOOTTIME", None)


def now() -> float:
    """Time since an arbitrary epoch, common to all processes of a machine [s]."""
    return time.monotonic() if BOOT_CLOCK is None else time.clock_gettime(BOOT_CLOCK)


class JumpDetector:
    """Detector of jumps of the wall clock relative to the monotonic clock."""

    # Smallest jump [s]; less is clock slewing by a time server, or a delay between the two readings.
    LEAST = 0.1

    def __init__(self) -> None:
        """Take the first reading."""
        self._offset = self._read()

    def jump(self) -> float:
        """Jump of the wall clock since the last call [s]; 0 if there was none."""
        offset, last = self._read(), self._offset
        self._offset = offset
        return offset - last if abs(offset - last) > self.LEAST else 0.0

    @staticmethod
    def _read() -> float:
        # The wall clock is read between two monotonic readings, so that preemption does not look like a jump.
        readings = [(now(), time.time_ns() * 1e-9, now()) for _ in range(3)]
        before, wall, after = min(readings, key=lambda reading: reading[2] - reading[0])
        return wall - (before + after) / 2
