"""The emulated laser: on or off, with a log of its changes."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Switching:
    """The laser changed at `time` [s] to `on`."""

    time: float
    on: bool


class Laser:
    """The laser. The caller says when it is switched; cameras ask for its past, which is kept."""

    def __init__(self, now: float) -> None:
        """Begin dark."""
        self._log: deque[Switching] = deque([Switching(now, False)], maxlen=8192)

    @property
    def on(self) -> bool:
        """Whether it shines now."""
        return self._log[-1].on

    @property
    def since(self) -> float:
        """When it last changed [s]."""
        return self._log[-1].time

    def switch(self, on: bool, now: float) -> None:
        """Switch at `now`; does nothing when the laser is in that state already."""
        if on != self.on:
            self._log.append(Switching(now, on))

    def switchings(self) -> tuple[Switching, ...]:
        """The changes still remembered, oldest first."""
        return tuple(self._log)

    def at(self, time: float) -> bool:
        """Whether it shone at `time`."""
        for event in reversed(self._log):
            if event.time <= time:
                return event.on
        return False

    def fraction(self, start: float, end: float) -> float:
        """The share of the interval `start` ... `end` during which it shone (0 ... 1)."""
        if end <= start:
            return 1.0 if self.at(start) else 0.0
        # From the newest change back: a camera asks for an interval just past, and the log may be long.
        lit, until = 0.0, end
        for event in reversed(self._log):
            if event.time < until:
                since = max(event.time, start)
                lit += (until - since) if event.on else 0.0
                until = since
            if event.time <= start:
                break
        return lit / (end - start)
