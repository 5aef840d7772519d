"""Monotonic clock for ages, which goes on while the machine sleeps."""

from __future__ import annotations

import time

# Linux: as CLOCK_MONOTONIC, but it counts the time in which the machine was suspended too.
BOOT_CLOCK = getattr(time, "CLOCK_BOOTTIME", None)


def now() -> float:
    """Time since an arbitrary instant [s], the same for all processes of one machine."""
    return time.monotonic() if BOOT_CLOCK is None else time.clock_gettime(BOOT_CLOCK)


class JumpDetector:
    """Detector of jumps of the wall clock against the monotonic clock."""

    # [s] Less is what time servers do when they slew a clock, and what a busy machine does between two readings.
    LEAST = 0.1

    def __init__(self) -> None:
        """Take the first reading."""
        self._offset = self._read()

    def jump(self) -> float:
        """Jump of the wall clock since the last call [s], 0 for none."""
        offset, last = self._read(), self._offset
        self._offset = offset
        return offset - last if abs(offset - last) > self.LEAST else 0.0

    @staticmethod
    def _read() -> float:
        # The wall clock between two readings of the other: an interrupted thread must not look like a jump.
        best, offset = float("inf"), 0.0
        for _ in range(3):
            before, wall, after = now(), time.time_ns() * 1e-9, now()
            if after - before < best:
                best, offset = after - before, wall - (before + after) / 2
        return offset
