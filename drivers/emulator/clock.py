"""A clock for emulated devices alone: waiting sets it forward, so nothing really waits."""

from __future__ import annotations

import threading


class EmulatedClock:
    """For `drivers.timing.on_clock`; thread-safe."""

    def __init__(self, start: float = 1000.0) -> None:
        """Begin at `start` [s]."""
        self._now = start
        self._lock = threading.Lock()

    def monotonic(self) -> float:
        """Return the time [s]."""
        with self._lock:
            return self._now

    def sleep(self, seconds: float) -> None:
        """Set the clock forward."""
        with self._lock:
            self._now += max(0.0, seconds)
