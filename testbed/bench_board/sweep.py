"""Sweep of the emulated firmware as a sequence of events: move, settle, trigger, flash, report."""

from __future__ import annotations

import enum
import math
from collections import deque
from dataclasses import replace

from drivers.board.board_records import seal
from drivers.board.protocol import (
    FLASH_LONGEST_US,
    FLASH_SHORTEST_US,
    PERIOD_LONGEST_US,
    STRIPE_MARK,
    SWEEP_PLACES,
    SWEEP_STRIPES,
    WAIT_UNIT_US,
    BoardFault,
    Request,
    Result,
    Shot,
    SweepOffFrames,
)
from drivers.board.sweep_records import STRIPE, StripeRecord
from testbed.bench_board.light import BenchLight
from testbed.bench_board.mirror import BenchMirror
from testbed.bench_board.shutter import Opening, Shutter

# Time after a trigger within which an exposure must start, and after the last one for surplus exposures [s].
EXPOSURE_WAIT, LAST_WAIT = 0.005, 0.002
# Duration of a flash after which the photodiode must have seen it [s].
SEEN_AFTER = 0.0002


# Minimum and maximum of each option.
OPTIONS = {
    Request.SWEEP_FLASH: (FLASH_SHORTEST_US, FLASH_LONGEST_US),
    Request.SWEEP_PERIOD: (0, PERIOD_LONGEST_US),
    Request.SWEEP_OFF_FRAMES: (0, max(SweepOffFrames)),
}


class Phase(enum.Enum):
    """Next event of a sweep."""

    IDLE = 0
    FIRE = 1
    SHINE = 2
    DARKEN = 3
    GO_ON = 4
    FINISH = 5


class SweepUnit:
    """Sweep executed by the board; the caller must call `act` at the time `due`."""

    def __init__(self, mirror: BenchMirror, light: BenchLight, shutter: Shutter) -> None:
        """Start without settings."""
        self._mirror, self._light, self.shutter = mirror, light, shutter
        self.triggers: list[float] = []
        self.openings: list[Opening] = []
        self._triggered_ever = 0
        self.forget(0.0)

    def forget(self, now: float) -> None:
        """Start a session: end a running sweep and clear all settings."""
        self._phase = getattr(self, "_phase", Phase.IDLE)
        self.end(now)
        self.due = math.inf
        self.ended_at: float | None = None
        self.records: deque[StripeRecord] = deque()
        self._table: dict[int, tuple[int, float]] = {}
        self._options = dict.fromkeys(OPTIONS, 0)
        self._dark_after: set[int] = set()
        self._number: int | None = None
        self._closed = -math.inf
        self._shot: StripeRecord | None = None

    @property
    def running(self) -> bool:
        """True while a sweep runs."""
        return self._phase is not Phase.IDLE

    def set_step(self, place: int, wait: int, step: int) -> Result:
        """Write an entry of the step table."""
        result = self._answer(place < SWEEP_PLACES and self._mirror.reaches(step))
        if result is Result.OK:
            self._table[place] = (step, wait * WAIT_UNIT_US * 1e-6)
        return result

    def set_option(self, request: Request, value: int) -> Result:
        """Set the longest flash or the shortest time between triggers [us], or the off frames."""
        lowest, highest = OPTIONS[request]
        result = self._answer(lowest <= value <= highest)
        if result is Result.OK:
            self._options[request] = value
        return result

    def set_dark(self, place: int, is_dark: int) -> Result:
        """Switch the dark flash after the stripe of a place on or off."""
        result = self._answer(place < SWEEP_PLACES and is_dark <= 1)
        if result is Result.OK:
            (self._dark_after.add if is_dark else self._dark_after.discard)(place)
        return result

    def _answer(self, is_within: bool) -> Result:
        """Result of a setting, which must be within its range and must not be changed during a sweep."""
        if not is_within:
            return Result.OUT_OF_RANGE
        return Result.BUSY if self.running else Result.OK

    def begin(self, argument: int, power_up: float, now: float) -> Result:
        """Start a sweep; `argument` is that of SWEEP, unsigned."""
        count, place, number = argument & 0xFFFF, argument >> 16 & (SWEEP_PLACES - 1), argument >> 25
        if number == self._number:
            return Result.OK
        if self.running or self._mirror.moving(now):
            return Result.BUSY
        if not self._mirror.homed:
            return Result.NOT_HOMED
        if not self._light.may_shine:
            return Result.LASER_REFUSED
        is_known = all(at in self._table for at in range(place, place + count))
        if not 1 <= count <= SWEEP_STRIPES or not self._options[Request.SWEEP_FLASH] or not is_known:
            return Result.OUT_OF_RANGE
        self._light.command(False, now)
        self._number, self._place, self._left = number, place, count
        self._power_up = power_up
        self._flash, self._period = (1e-6 * self._options[each] for each in (Request.SWEEP_FLASH, Request.SWEEP_PERIOD))
        self._off_frames = SweepOffFrames(self._options[Request.SWEEP_OFF_FRAMES])
        self._is_off = self._off_frames is SweepOffFrames.ONE
        self._offs_due = 0
        self._has_shone = False
        self._last_trigger = -math.inf
        self.records.clear()
        self._mirror.count_motion()
        self._turn(now)
        self._plan(now)
        return Result.OK

    def end(self, now: float) -> None:
        """End the sweep, turn the laser off and stop the mirror; does nothing if no sweep is running."""
        if self.running:
            self._mirror.halt_sweep(now)
            self._finish(now)

    def act(self) -> None:
        """Execute the next event, as of its time."""
        now = self.due
        match self._phase:
            case Phase.FIRE:
                self._fire(now)
            case Phase.SHINE:
                self._shine(now)
            case Phase.DARKEN:
                self._darken(now)
            case Phase.GO_ON:
                self._next(now)
            case Phase.FINISH:
                self._finish(now)

    def _wait_for(self, phase: Phase, due: float) -> None:
        self._phase, self.due = phase, due

    def _turn(self, now: float) -> None:
        self._mirror.sweep_to(self._table[self._place][0], now)

    def _plan(self, now: float) -> None:
        due = max(now, self._last_trigger + self._period)
        if not self._is_off:
            due = max(due, self._mirror.still_at + self._table[self._place][1])
        if self.shutter.wired:
            due = max(due, self._closed)
        self._wait_for(Phase.FIRE, due)

    def _fire(self, now: float) -> None:
        self._write(now)
        if not self._is_off and self._light.laser.on:
            self._light.cut(BoardFault.LASER_STUCK_ON, now)
            self.end(now)
            return
        openings = self.shutter.openings(self._triggered_ever, now, self._closed)
        self._triggered_ever += 1
        self.triggers.append(now)
        self.openings.extend(openings)
        self._last_trigger, self._current = now, openings
        if openings:
            self._closed = openings[-1][1]
        self._shot = StripeRecord(
            shot=Shot.OFF if self._is_off else Shot.STRIPE,
            motion=self._mirror.motions & 0xFFFF,
            place=self._place,
            left=self._left - (0 if self._is_off else 1),
            clock=now - self._power_up,
            exposures=0,
            delay=0.0,
            exposure=0.0,
            lit=0.0,
            faults=BoardFault(0),
            step=self._mirror.step(now) if self._is_off else self._table[self._place][0],
        )
        self._lit = 0.0
        if not self.shutter.wired:
            self._wait_for(Phase.GO_ON if self._is_off else Phase.SHINE, now + (self._flash if self._is_off else 0.0))
        elif not openings or openings[0][0] > now + EXPOSURE_WAIT:
            self._wait_for(Phase.GO_ON, now + EXPOSURE_WAIT)
        else:
            self._wait_for(*((Phase.GO_ON, openings[0][1]) if self._is_off else (Phase.SHINE, openings[0][0])))

    def _shine(self, now: float) -> None:
        if not self._light.flash(now, goes_on=self._has_shone):
            self.end(now)
            return
        self._has_shone, self._lit_since = True, now
        closes = self._current[0][1] if self.shutter.wired else math.inf
        self._wait_for(Phase.DARKEN, min(now + self._flash, closes))

    def _darken(self, now: float) -> None:
        seen = self._light.sensed
        self._light.command(False, now)
        self._lit = now - self._lit_since
        if not seen and self._lit >= SEEN_AFTER:
            self._light.faults |= BoardFault.LASER_DEAD
            self.end(now)
            return
        self._next(now)

    def _next(self, now: float) -> None:
        if not self._is_off:
            self._offs_due = (self._off_frames is SweepOffFrames.PER_STRIPE) + (self._place in self._dark_after)
            self._left -= 1
            self._place += 1
            if self._left:
                self._turn(now)
        self._is_off = self._offs_due > 0
        self._offs_due -= self._is_off
        if self._left == 0 and not self._is_off:
            self._wait_for(Phase.FINISH, now + LAST_WAIT)
        else:
            self._plan(now)

    def _finish(self, now: float) -> None:
        self._light.command(False, now)
        self._write(now)
        self._wait_for(Phase.IDLE, math.inf)
        self.ended_at = now

    def _write(self, now: float) -> None:
        shot, self._shot = self._shot, None
        if shot is None:
            return
        seen = [opening for opening in self._current if opening[0] <= now] if self.shutter.wired else []
        delay = seen[0][0] - self._last_trigger if seen else 0.0
        exposure = seen[0][1] - seen[0][0] if seen and seen[0][1] <= now else 0.0
        faults = self._light.faults | self._mirror.faults
        self.records.append(
            replace(shot, exposures=len(seen), delay=delay, exposure=exposure, lit=self._lit, faults=faults)
        )


def packed(record: StripeRecord) -> bytes:
    """Bytes of a record as the board sends them."""
    return seal(
        STRIPE.pack(
            STRIPE_MARK,
            record.shot,
            record.motion & 0xFFFF,
            record.place,
            record.left,
            round(record.clock * 1e6) & 0xFFFFFFFF,
            record.exposures,
            *(min(65535, round(seconds * 1e6)) for seconds in (record.delay, record.exposure, record.lit)),
            record.faults,
            record.step,
            0,
            0,
        )
    )
