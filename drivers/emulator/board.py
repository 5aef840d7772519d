"""Emulated board: executes the commands of `PROTOCOL.md`, and provides laser and mirror to emulated cameras."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from dataclasses import replace

from drivers import timing
from drivers.board.board_records import BoardStatus
from drivers.board.protocol import PROTOCOL_MAJOR, REQUESTS, SWEEP_PLACES, BoardFault, BoardFlag, Request, Result
from drivers.emulator.config import EmulatorConfig
from drivers.emulator.faults import Fault, FaultKind, FaultPlan
from drivers.emulator.light import LightUnit, Switching
from drivers.emulator.mirror import MirrorUnit
from drivers.emulator.shutter import Opening, Shutter
from drivers.emulator.sweep import SweepUnit
from drivers.emulator.views import BoardView, ExposureView

REPORTS_KEPT = 4


class EmulatedBoard:
    """Laser board in software; thread-safe.

    Nothing runs in the background: each call first applies all timers, as of the times at which they were due.

    Attributes:
        config: configuration.
        clock: function that returns the time [s].
        plan: pending faults.
        shutter: shutter of the camera that this board triggers.
        plugged: True while the board is on the bus.
    """

    def __init__(self, config: EmulatorConfig | None = None, clock: Callable[[], float] = timing.monotonic) -> None:
        """Power up, with the mirror at the centre of its travel and its home unknown.

        Args:
            config: configuration; None = defaults.
            clock: function that returns the time [s].
        """
        self.config = config or EmulatorConfig()
        self.clock = clock
        self.plan = FaultPlan()
        self._lock = threading.RLock()
        self._reports: deque[bytes] = deque(maxlen=REPORTS_KEPT)
        now = clock()
        self._mirror = MirrorUnit(self.config, self.plan, now)
        self._light = LightUnit(self.config.identity, self.plan, self.config.temperature, now)
        self.shutter = Shutter()
        self._sweep = SweepUnit(self._mirror, self._light, self.shutter)
        self._power_on(now)

    def inject(self, fault: Fault) -> None:
        """Add a fault to the plan; see `FaultKind`."""
        self.plan.add(fault)

    def mend(self) -> None:
        """Remove all injected faults; fault bits that are set remain until the host clears them."""
        self.plan.clear()

    def unplug(self) -> None:
        """Unplug the board: it loses power, the laser is off and the mirror stops."""
        with self._lock:
            now = self._advance()
            self.plugged = False
            self._sweep.end(now)
            self._light.power_off(now)
            self._mirror.halt(now)

    def replug(self) -> None:
        """Plug in again: power-up, home unknown; does nothing when plugged in."""
        with self._lock:
            if not self.plugged:
                self._power_on(self._advance())

    def serve(self, request: int, argument: int) -> bytes | None:
        """Execute a command and return its data stage; None for a command that the firmware does not know."""
        with self._lock:
            now = self._advance()
            known = REQUESTS.get(request)
            if known is None or self.config.identity.protocol[1] < minor_of(known):
                return None
            if known is Request.IDENTIFY:
                return self._identity()
            if known is Request.MOTION:
                return self._mirror.motion_profile.pack()
            if self._session:
                self._light.feed(now)
            self._sequence += 1
            result = self._do(known, argument, now)
            return self._status(result, known, now)

    def next_report(self) -> bytes | None:
        """Return the oldest waiting record of the interrupt endpoint, or None."""
        with self._lock:
            self._advance()
            if self._sweep.records:
                return self._sweep.records.popleft().pack()
            return self._reports.popleft() if self._reports else None

    def still_at(self) -> float:
        """End of the current motion, including settling [s]."""
        with self._lock:
            return self._mirror.still_at

    def view(self, at: float | None = None) -> BoardView:
        """State of the board at a time by its clock [s]; None = now."""
        with self._lock:
            now = self._advance()
            instant = now if at is None else at
            return BoardView(
                time=instant,
                plugged=self.plugged,
                laser_on=self._light.laser.at(instant),
                laser_since=self._light.laser.since,
                mirror_angle=self._mirror.true_angle(instant),
                mirror_angle_commanded=self._mirror.believed_angle(instant),
                moving=self._mirror.moving(instant),
                faults=int(self._faults()),
            )

    def exposure(self, start: float, end: float) -> ExposureView:
        """State of the board during an exposure from `start` to `end` [s], both in the past."""
        with self._lock:
            self._advance()
            angle = self._mirror.true_angle
            return ExposureView(
                start=start,
                end=end,
                laser_fraction=self._light.laser.fraction(start, end),
                mirror_angle=angle(0.5 * (start + end)),
                mirror_travel=abs(angle(end) - angle(start)),
            )

    def triggers(self) -> tuple[float, ...]:
        """Times of the triggers [s], oldest first."""
        with self._lock:
            self._advance()
            return tuple(self._sweep.triggers)

    def openings(self, first: int = 0) -> tuple[Opening, ...]:
        """Openings (start, end) of the triggered camera's shutter [s], from number `first` on."""
        with self._lock:
            self._advance()
            return tuple(self._sweep.openings[first:])

    def switchings(self) -> tuple[Switching, ...]:
        """Changes of the laser, oldest first (the last few thousand)."""
        with self._lock:
            self._advance()
            return self._light.laser.switchings()

    def _power_on(self, now: float) -> None:
        self.plugged = True
        self._power_up = now
        self._session = False
        self._sequence = 0
        self._reports.clear()
        self._faults_reported = BoardFault(0)
        self._mirror.power_on(now)
        self._light.power_on(now)
        self._sweep.forget(now)

    def _advance(self) -> float:
        now = self.clock()
        self._run_sweep(now)
        ended = self._mirror.ended(now)
        if ended is not None:
            # The report contains the state at that time, even if it is read later.
            self._report(ended)
        self._light.advance(now)
        self._mirror.advance(now)
        if self._faults() != self._faults_reported:
            self._report(now)
        return now

    def _run_sweep(self, now: float) -> None:
        while self._sweep.running:
            instant = min(self._sweep.due, self._light.silent_at)
            if instant > now:
                break
            self._light.advance(instant)
            if self._light.silent_at <= instant:
                self._light.cut(BoardFault.WATCHDOG, instant)
            if self._light.may_shine:
                self._sweep.act()
            else:
                self._sweep.end(instant)
        ended, self._sweep.ended_at = self._sweep.ended_at, None
        if ended is not None and not self._mirror.moving(ended):
            self._report(ended)

    def _report(self, instant: float) -> None:
        self._light.advance(instant)
        self._mirror.advance(instant)
        self._faults_reported = self._faults()
        self._reports.append(self._status(Result.OK, 0, instant))

    def _faults(self) -> BoardFault:
        mirror, light = self._mirror.faults, self._light.faults
        return mirror | light if mirror and light else mirror or light

    def _identity(self) -> bytes:
        wrong = self.plan.holds(FaultKind.WRONG_VERSION)
        if wrong is None:
            return self.config.identity.pack()
        return replace(self.config.identity, protocol=(wrong.amount >> 8, wrong.amount & 0xFF)).pack()

    def _do(self, request: Request, argument: int, now: float) -> Result:
        match request:
            case Request.STATUS:
                return Result.OK
            case Request.HELLO:
                if argument >> 8 != PROTOCOL_MAJOR:
                    return Result.VERSION
                self._session = True
                self._sweep.forget(now)
                self._mirror.reset_motion()
                self._light.command(False, now)
                self._light.clear(BoardFault.WATCHDOG, now)
                self._mirror.halt(now)
                return Result.OK
            case Request.GOODBYE:
                self._session = False
                self._sweep.end(now)
                self._light.command(False, now)
                self._mirror.halt(now)
                return Result.OK
            case Request.LASER if not argument:
                self._sweep.end(now)
                self._light.command(False, now)
                return Result.OK
        if not self._session:
            return Result.NO_SESSION
        if request >= Request.SWEEP_STEP:
            return self._do_sweep(request, argument & 0xFFFFFFFF, argument, now)
        if self._sweep.running and request in (Request.LASER, Request.HOME, Request.GO_TO):
            return Result.BUSY
        match request:
            case Request.LASER:
                return Result.OK if self._light.command(True, now) else Result.LASER_REFUSED
            case Request.HOME:
                return self._mirror.home(now)
            case Request.GO_TO:
                return self._mirror.go_to(argument, now)
            case Request.HALT:
                self._sweep.end(now)
                self._mirror.halt(now)
            case Request.CLEAR_FAULTS:
                faults = BoardFault(argument & 0x7F)
                self._mirror.faults &= ~faults
                self._light.clear(faults, now)
        return Result.OK

    def _do_sweep(self, request: Request, bits: int, argument: int, now: float) -> Result:
        match request:
            case Request.SWEEP_STEP:
                step = (bits & 0xFFFF ^ 0x8000) - 0x8000
                return self._sweep.set_step(bits >> 16 & (SWEEP_PLACES - 1), bits >> 25, step)
            case Request.SWEEP_FLASH | Request.SWEEP_PERIOD | Request.SWEEP_OFF_FRAMES:
                return self._sweep.set_option(request, argument)
            case Request.SWEEP:
                return self._sweep.begin(bits, self._power_up, now)
            case Request.SWEEP_DARK:
                return self._sweep.set_dark(bits & 0xFFFF, bits >> 16)
        return Result.BUSY if self._sweep.running else self._mirror.set_motion(request, argument, now)

    def _sweep_flags(self) -> int:
        if self.config.identity.protocol < (1, 1):
            return 0
        flags = int(BoardFlag.HAS_SWEEP)
        flags |= int(BoardFlag.COUNTS_EXPOSURES) if self.shutter.wired else 0
        return flags | (int(BoardFlag.SWEEPING | BoardFlag.MOVING) if self._sweep.running else 0)

    def _status(self, result: Result, request: int, instant: float) -> bytes:
        session = int(BoardFlag.SESSION) if self._session else 0
        flags = session | self._light.flags() | self._mirror.flags(instant) | self._sweep_flags()
        status = BoardStatus(
            result,
            request,
            self._sequence,
            BoardFlag(flags),
            self._faults(),
            self._mirror.step(instant),
            self._mirror.motions,
            self._light.temperature(),
            self._mirror.home_error,
            self._light.time_on(instant),
            instant - self._power_up,
        )
        return status.pack()


def minor_of(request: Request) -> int:
    """First minor version of protocol 1 that has a request."""
    if request is Request.SWEEP_DARK:
        return 2
    return 1 if request >= Request.SWEEP_STEP else 0
