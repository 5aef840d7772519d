"""Monotonic clock for the ages of messages; on Linux it keeps running while the machine is suspended."""

from __future__ import annotations

import time

# Linux clock that equals CLOCK_MONOTONIC plus the time during which the machine was suspended.
BOOT_CLOCK = getattr(time, "CLOCK_BOOTTIME", None)


def now() -> float:
    """Return the time since an arbitrary epoch [s], which is common to all processes of a machine."""
    return time.monotonic() if BOOT_CLOCK is None else time.clock_gettime(BOOT_CLOCK)


class JumpDetector:
    """Detector of jumps of the wall clock relative to the monotonic clock."""

    # Change of the offset above which the wall clock has jumped [s]; smaller changes come from slewing by a time server
    # or from delays between readings.
    LEAST = 0.1

    def __init__(self) -> None:
        """Read both clocks for the first time."""
        self._offset = self._read()

    def jump(self) -> float:
        """Return the jump of the wall clock since the last call [s]; 0 if there was none."""
        offset, last = self._read(), self._offset
        self._offset = offset
        return offset - last if abs(offset - last) > self.LEAST else 0.0

    @staticmethod
    def _read() -> float:
        # The wall clock is read between two monotonic readings, so that preemption does not look like a jump.
        readings = [(now(), time.time_ns() * 1e-9, now()) for _ in range(3)]
        before, wall, after = min(readings, key=lambda reading: reading[2] - reading[0])
        return wall - (before + after) / 2
