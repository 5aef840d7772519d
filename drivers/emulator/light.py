"""Emulated laser and its firmware: switch, photodiode, watchdog, time limit, temperature and supply relay."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

from drivers.board.board_records import BoardIdentity
from drivers.board.protocol import BLOCKING, BoardFault, BoardFlag


@dataclass(frozen=True, slots=True)
class Switching:
    """Change of the laser to the state `on` at `time` [s]."""

    time: float
    on: bool


class Laser:
    """Emulated laser with a log of its changes, from which the light during an exposure is computed.

    Attributes:
        log: changes of the laser, oldest first.
    """

    def __init__(self, now: float) -> None:
        """Start with the laser off."""
        self.log: deque[Switching] = deque([Switching(now, False)], maxlen=8192)

    @property
    def on(self) -> bool:
        """True while the laser is on."""
        return self.log[-1].on

    def switch(self, on: bool, now: float) -> None:
        """Switch the laser at `now`; does nothing if the laser is already in that state."""
        if on != self.on:
            self.log.append(Switching(now, on))

    def fraction(self, start: float, end: float) -> float:
        """Return the fraction of the interval from `start` to `end` during which the laser was on, 0 ... 1.

        If `end` is not after `start`, return 1.0 if the laser was on at `start`, otherwise 0.0.
        """
        if end <= start:
            return float(next((event.on for event in reversed(self.log) if event.time <= start), False))
        # Search backwards from the newest change: the interval is recent, and the log may be long.
        lit, until = 0.0, end
        for event in reversed(self.log):
            if event.time < until:
                since = max(event.time, start)
                lit += (until - since) if event.on else 0.0
                until = since
            if event.time <= start:
                break
        return lit / (end - start)


class LightUnit:
    """Emulated laser, its supply relay, and the safety timers of its firmware."""

    def __init__(self, identity: BoardIdentity, temperature: float, now: float) -> None:
        """Start with the laser off; `temperature` is that of the board [degrees Celsius]."""
        self.laser = Laser(now)
        self._identity, self._temperature = identity, temperature
        self.power_on(now)

    def power_on(self, now: float) -> None:
        """Reset the state of the firmware, as at power-up."""
        self.faults = BoardFault(0)
        self._commanded = False
        self._supply = True
        self._fed = now
        self._run_start = self._run_end = -math.inf
        self._update(now)

    def feed(self, now: float) -> None:
        """Reset the watchdog."""
        self._fed = now

    def command(self, on: bool, now: float) -> bool:
        """Switch the laser; return False if a blocking fault prevents switching it on."""
        if on and self.faults & BLOCKING:
            return False
        if on and not self._commanded:
            if now - self._run_end >= self._identity.laser_rest:
                self._run_start = now
            self._commanded, self._fed = True, now
        if not on:
            self._commanded = False
        self._update(now)
        return True

    def clear(self, faults: BoardFault, now: float) -> None:
        """Clear `faults`, but LASER_TIME only after the rest; reconnect the supply if no blocking fault remains."""
        if now - self._run_end < self._identity.laser_rest:
            faults &= ~BoardFault.LASER_TIME
        self.faults &= ~faults
        self._supply = not self.faults & BLOCKING
        self._update(now)

    def advance(self, now: float) -> None:
        """If safety timers have expired, cut the laser as of the first expiry, with the fault of that timer."""
        if not self.laser.on:
            return
        silent, limit = self._fed + self._identity.watchdog, self._run_start + self._identity.laser_limit
        if min(silent, limit) <= now:
            self.cut(BoardFault.WATCHDOG if silent <= limit else BoardFault.LASER_TIME, min(silent, limit))

    def flags(self) -> int:
        """Return the laser's bits of the status flags."""
        # Integers are used because operators of enums would take most of the time of a transfer.
        flags = int(BoardFlag.HAS_SENSOR)
        flags |= int(BoardFlag.LASER_COMMANDED) if self._commanded else 0
        flags |= int(BoardFlag.LASER_SENSED) if self.sensed else 0
        return flags

    def temperature(self) -> float:
        """Return the temperature of the board [degrees Celsius]."""
        return self._temperature

    def time_on(self, now: float) -> float:
        """Return the time since the laser's last full rest, shorter gaps included [s]; 0 while the laser is off."""
        return now - self._run_start if self.laser.on else 0.0

    @property
    def sensed(self) -> bool:
        """True if the photodiode detects the laser."""
        return self.laser.on

    def cut(self, fault: BoardFault, now: float) -> None:
        """Set a fault, turn the laser off and disconnect its supply."""
        self.faults |= fault
        self._supply = self._commanded = False
        self._update(now)

    def _shines(self) -> bool:
        return self._supply and self._commanded

    def _update(self, now: float) -> None:
        shines = self._shines()
        if self.laser.on and not shines:
            self._run_end = now
        self.laser.switch(shines, now)
