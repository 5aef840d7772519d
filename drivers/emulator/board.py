"""Emulated laser board: executes the commands of protocol 1.0, and shows emulated cameras its laser and mirror."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from dataclasses import replace

from drivers import timing
from drivers.board.board_records import BoardStatus
from drivers.board.protocol import PROTOCOL_MAJOR, REQUESTS, BoardFault, BoardFlag, Request, Result
from drivers.emulator.config import EmulatorConfig
from drivers.emulator.light import LightUnit
from drivers.emulator.mirror import MirrorUnit
from drivers.emulator.views import ExposureView

REPORTS_KEPT = 4


class EmulatedBoard:
    """Software emulation of a laser board with protocol 1.0; thread-safe.

    Nothing runs in the background. Before a command, report or exposure is served, each expired timer takes effect with
    its own time of expiry.

    Attributes:
        config: configuration of the emulator.
        clock: function that returns the time [s].
    """

    def __init__(self, config: EmulatorConfig | None = None, clock: Callable[[], float] = timing.monotonic) -> None:
        """Power up, with the mirror at the centre of its travel and the home position unknown.

        Args:
            config: configuration of the emulator; None = defaults.
            clock: function that returns the time [s].
        """
        self.config = config or EmulatorConfig()
        self.clock = clock
        self._lock = threading.RLock()
        self._reports: deque[bytes] = deque(maxlen=REPORTS_KEPT)
        now = clock()
        self._mirror, self._light = self._units(now)
        self._power_on(now)

    def serve(self, request: int, argument: int) -> bytes | None:
        """Execute a command and return the data of its reply; None for a command that the firmware does not know."""
        with self._lock:
            now = self._advance()
            known = REQUESTS.get(request)
            if known is None or not self._knows(known):
                return None
            record = self._record(known)
            if record is not None:
                return record
            if self._session:
                self._light.feed(now)
            self._sequence += 1
            result = self._do(known, argument, now)
            return self._status(result, known, now)

    def next_report(self) -> bytes | None:
        """Return the oldest waiting report of the interrupt endpoint, or None."""
        with self._lock:
            self._advance()
            return self._reports.popleft() if self._reports else None

    def still_at(self) -> float:
        """Return the time at which the last motion ends or has ended, including settling [s]."""
        with self._lock:
            return self._mirror.still_at

    def exposure(self, start: float, end: float) -> ExposureView:
        """Return the state of the board during an exposure from `start` to `end` [s], which must be in the past."""
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

    def _power_on(self, now: float) -> None:
        self._power_up = now
        self._session = False
        self._sequence = 0
        self._reports.clear()
        self._faults_reported = BoardFault(0)
        self._mirror.power_on(now)
        self._light.power_on(now)

    def _units(self, now: float) -> tuple[MirrorUnit, LightUnit]:
        return MirrorUnit(self.config, now), LightUnit(self.config.identity, self.config.temperature, now)

    def _advance(self) -> float:
        now = self.clock()
        self._apply(now)
        return now

    def _apply(self, now: float) -> None:
        ended = self._mirror.ended(now)
        if ended is not None:
            # The report contains the state at the end of the motion, even if it is read later.
            self._report(ended)
        self._light.advance(now)
        self._mirror.advance(now)
        if self._faults() != self._faults_reported:
            self._report(now)

    def _report(self, instant: float) -> None:
        self._light.advance(instant)
        self._mirror.advance(instant)
        self._faults_reported = self._faults()
        self._reports.append(self._status(Result.OK, 0, instant))

    def _faults(self) -> BoardFault:
        return self._light.faults

    def _knows(self, request: Request) -> bool:
        return request < Request.SWEEP_STEP

    def _record(self, request: Request) -> bytes | None:
        """Return the reply to a request for a record other than the status; None for all other requests."""
        identity = replace(self.config.identity, protocol=(PROTOCOL_MAJOR, 0))
        return identity.pack() if request is Request.IDENTIFY else None

    def _do(self, request: Request, argument: int, now: float) -> Result:
        match request:
            case Request.STATUS:
                return Result.OK
            case Request.HELLO:
                if argument >> 8 != PROTOCOL_MAJOR:
                    return Result.VERSION
                self._session = True
                self._light.command(False, now)
                self._light.clear(BoardFault.WATCHDOG, now)
                self._mirror.halt(now)
                return Result.OK
            case Request.GOODBYE:
                self._session = False
                self._light.command(False, now)
                self._mirror.halt(now)
                return Result.OK
            case Request.LASER if not argument:
                self._light.command(False, now)
                return Result.OK
        if not self._session:
            return Result.NO_SESSION
        match request:
            case Request.LASER:
                return Result.OK if self._light.command(True, now) else Result.LASER_REFUSED
            case Request.HOME:
                return self._mirror.home(now)
            case Request.GO_TO:
                return self._mirror.go_to(argument, now)
            case Request.HALT:
                self._mirror.halt(now)
            case Request.CLEAR_FAULTS:
                self._light.clear(BoardFault(argument & 0x7F), now)
        return Result.OK

    def _flags(self, instant: float) -> int:
        session = int(BoardFlag.SESSION) if self._session else 0
        return session | self._light.flags() | self._mirror.flags(instant)

    def _status(self, result: Result, request: int, instant: float) -> bytes:
        status = BoardStatus(
            result,
            request,
            self._sequence,
            BoardFlag(self._flags(instant)),
            self._faults(),
            self._mirror.step(instant),
            self._mirror.motions,
            self._light.temperature(),
            self._mirror.home_error,
            self._light.time_on(instant),
            instant - self._power_up,
        )
        return status.pack()
