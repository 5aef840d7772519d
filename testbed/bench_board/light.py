"""Laser of the bench board: flashed by sweeps, with possible faults of transistor, photodiode and temperature."""

from __future__ import annotations

from drivers.board.board_records import BoardIdentity
from drivers.board.protocol import BLOCKING, BoardFault
from drivers.emulator.light import LightUnit
from testbed.bench_board.faults import FaultKind, FaultPlan

# Temperature at which the laser is turned off, and temperature at which this fault can be cleared [degrees Celsius].
TOO_HOT, COOL_ENOUGH = 60.0, 55.0
# Time for which the firmware waits for the photodiode before it disconnects the supply [s].
SENSE_DELAY = 0.005


class BenchLight(LightUnit):
    """Laser, its transistor (which may stick), its supply relay, and its safety timers."""

    _latched = False

    def __init__(self, identity: BoardIdentity, plan: FaultPlan, temperature: float, now: float) -> None:
        """Start switched off; `temperature` is that of a healthy board [degrees Celsius]."""
        self._plan = plan
        super().__init__(identity, temperature, now)

    def power_on(self, now: float) -> None:
        """Start as after a reset."""
        self._latched = False
        super().power_on(now)

    def power_off(self, now: float) -> None:
        """Lose USB power."""
        self._supply = self._commanded = False
        self._update(now)

    def command(self, on: bool, now: float) -> bool:
        """Switch the laser and compare it with the photodiode; return True if the firmware permits the command."""
        if not super().command(on, now):
            return False
        if on and not self.sensed:
            self.faults |= BoardFault.LASER_DEAD
            self._commanded = False
        if not on and self.sensed:
            self.cut(BoardFault.LASER_STUCK_ON, now + SENSE_DELAY)
        return True

    @property
    def may_shine(self) -> bool:
        """True if no fault prevents the laser."""
        return not self.faults & BLOCKING

    @property
    def silent_at(self) -> float:
        """Time at which the watchdog turns the laser off unless it is fed [s]."""
        return self._fed + self._identity.watchdog

    def flash(self, now: float, goes_on: bool) -> bool:
        """Switch on in a sweep without feeding the watchdog; return True if the firmware permits it.

        Args:
            now: current time [s].
            goes_on: True for a further flash of the same sweep, whose lit time is added regardless of the gap.
        """
        if not self.may_shine:
            return False
        if goes_on:
            self._run_start += now - self._run_end
        elif now - self._run_end >= self._identity.laser_rest:
            self._run_start = now
        self._commanded = True
        self._update(now)
        return True

    def clear(self, faults: BoardFault, now: float) -> None:
        """Clear those of `faults` whose cause no longer exists."""
        if self.temperature() > COOL_ENOUGH:
            faults &= ~BoardFault.OVER_TEMPERATURE
        if self._plan.holds(FaultKind.LASER_STUCK_ON):
            faults &= ~BoardFault.LASER_STUCK_ON
        super().clear(faults, now)

    def advance(self, now: float) -> None:
        """Apply the hardware timers that are due and the temperature limit."""
        if self.temperature() >= TOO_HOT and BoardFault.OVER_TEMPERATURE not in self.faults:
            self.cut(BoardFault.OVER_TEMPERATURE, now)
        super().advance(now)

    def temperature(self) -> float:
        """Temperature of the board [degrees Celsius]."""
        hot = self._plan.holds(FaultKind.HOT)
        return super().temperature() if hot is None else float(hot.amount)

    @property
    def sensed(self) -> bool:
        """True if the photodiode sees the laser."""
        return self._commanded if self._plan.holds(FaultKind.BLIND_SENSOR) else self.laser.on

    def _shines(self) -> bool:
        driven = self._commanded and not self._plan.holds(FaultKind.LASER_STUCK_OFF)
        if driven and self._supply and self._plan.holds(FaultKind.LASER_STUCK_ON):
            self._latched = True
        self._latched = self._latched and self._plan.holds(FaultKind.LASER_STUCK_ON) is not None
        return self._supply and (driven or self._latched)
