"""The monotonic clock of all devices. For emulated devices it can be an emulated one: then nothing really waits."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol


class Clock(Protocol):
    """A clock on which one can wait."""

    def monotonic(self) -> float:
        """Return the time [s]."""

    def sleep(self, seconds: float) -> None:
        """Return when this much time has passed."""


class _MachineClock:
    monotonic = staticmethod(time.monotonic)
    sleep = staticmethod(time.sleep)


_clock: Clock = _MachineClock()


def monotonic() -> float:
    """Return the time [s] on the clock in use."""
    return _clock.monotonic()


def sleep(seconds: float) -> None:
    """Wait on the clock in use."""
    _clock.sleep(seconds)


@contextmanager
def on_clock(clock: Clock) -> Iterator[None]:
    """Make every device of this process use `clock` within the block."""
    global _clock
    before, _clock = _clock, clock
    try:
        yield
    finally:
        _clock = before
