"""Monotonic clock of the drivers; it can be replaced, so that emulated devices run without waiting."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol


class Clock(Protocol):
    """Interface of a clock: time and waiting."""

    def monotonic(self) -> float:
        """Return the current time [s]."""

    def sleep(self, seconds: float, /) -> None:
        """Wait for `seconds`."""


_clock: Clock = time


def monotonic() -> float:
    """Return the time on the clock in use [s]."""
    return _clock.monotonic()


def sleep(seconds: float) -> None:
    """Wait for `seconds` on the clock in use."""
    _clock.sleep(seconds)


@contextmanager
def on_clock(clock: Clock) -> Iterator[None]:
    """Make `monotonic` and `sleep` use `clock` within the block, in all threads."""
    global _clock
    before, _clock = _clock, clock
    try:
        yield
    finally:
        _clock = before


class EmulatedClock:
    """Clock for emulated devices, used with `on_clock`; waiting advances the time at once. Thread-safe."""

    def __init__(self, start: float = 1000.0) -> None:
        """Start at `start` [s]."""
        self._now = start
        self._lock = threading.Lock()

    def monotonic(self) -> float:
        """Return the current time [s]."""
        with self._lock:
            return self._now

    def catch_up(self) -> None:
        """Advance to the time of the machine's monotonic clock, so that stamps of both clocks can be compared."""
        with self._lock:
            self._now = max(self._now, time.monotonic())

    def sleep(self, seconds: float) -> None:
        """Advance the clock by `seconds`."""
        with self._lock:
            self._now += max(0.0, seconds)
