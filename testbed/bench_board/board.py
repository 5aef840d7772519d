"""Emulated board with sweeps and faults: executes all commands of `PROTOCOL.md`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from drivers import timing
from drivers.board.protocol import PROTOCOL_MAJOR, SWEEP_PLACES, BoardFault, BoardFlag, Request, Result
from drivers.emulator.board import EmulatedBoard
from drivers.emulator.config import EmulatorConfig
from drivers.emulator.light import Switching
from testbed.bench_board.faults import Fault, FaultKind, FaultPlan
from testbed.bench_board.light import BenchLight
from testbed.bench_board.mirror import BenchMirror
from testbed.bench_board.shutter import Opening, Shutter
from testbed.bench_board.sweep import SweepUnit, packed


@dataclass(frozen=True, slots=True)
class BoardView:
    """State of the emulated board at one time.

    Attributes:
        time: the time, on the monotonic clock [s].
        plugged: True if the board is connected now.
        laser_on: True if the laser was on at `time`.
        laser_since: time at which the laser was last switched [s].
        mirror_angle: true mirror angle [rad].
        mirror_angle_commanded: mirror angle assumed by the firmware, which differs after lost steps [rad].
        moving: True if the mirror was moving or settling.
        faults: current fault bits.
    """

    time: float
    plugged: bool
    laser_on: bool
    laser_since: float
    mirror_angle: float
    mirror_angle_commanded: float
    moving: bool
    faults: int


class BenchBoard(EmulatedBoard):
    """Emulated laser board with the protocol version of its configuration and injectable faults; thread-safe.

    Attributes:
        plan: pending faults.
        shutter: shutter of the camera that this board triggers.
        plugged: True while the board is on the bus.
        bus_delay: duration of a command transfer [s]; about 0.001 for a real full-speed control transfer.
    """

    bus_delay = 0.0
    _mirror: BenchMirror
    _light: BenchLight

    def __init__(self, config: EmulatorConfig | None = None, clock: Callable[[], float] = timing.monotonic) -> None:
        """Power up with the mirror at the centre of its travel, not homed.

        Args:
            config: configuration; None = defaults.
            clock: function that returns the time [s].
        """
        self.plan, self.shutter = FaultPlan(), Shutter()
        super().__init__(config, clock)

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
        """Plug the board in again: it powers up, not homed. Does nothing if it is plugged in."""
        with self._lock:
            if not self.plugged:
                self._power_on(self._advance())

    def next_report(self) -> bytes | None:
        """Return the oldest waiting record of the interrupt endpoint, or None."""
        with self._lock:
            self._advance()
            return packed(self._sweep.records.popleft()) if self._sweep.records else super().next_report()

    def view(self, at: float | None = None) -> BoardView:
        """Return the state of the board at a time on its clock [s]; None = now."""
        with self._lock:
            now = self._advance()
            instant = now if at is None else at
            return BoardView(
                time=instant,
                plugged=self.plugged,
                laser_on=self._light.laser.fraction(instant, instant) == 1.0,
                laser_since=self._light.laser.log[-1].time,
                mirror_angle=self._mirror.true_angle(instant),
                mirror_angle_commanded=self._mirror.believed_angle(instant),
                moving=self._mirror.moving(instant),
                faults=int(self._faults()),
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
            return tuple(self._light.laser.log)

    def _power_on(self, now: float) -> None:
        self.plugged = True
        super()._power_on(now)
        self._sweep.forget(now)

    def _units(self, now: float) -> tuple[BenchMirror, BenchLight]:
        mirror = BenchMirror(self.config, self.plan, now)
        light = BenchLight(self.config.identity, self.plan, self.config.temperature, now)
        self._sweep = SweepUnit(mirror, light, self.shutter)
        return mirror, light

    def _apply(self, now: float) -> None:
        self._run_sweep(now)
        super()._apply(now)

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

    def _faults(self) -> BoardFault:
        mirror, light = self._mirror.faults, super()._faults()
        return mirror | light if mirror and light else mirror or light

    def _knows(self, request: Request) -> bool:
        return self.config.identity.protocol[1] >= minor_of(request)

    def _record(self, request: Request) -> bytes | None:
        if request is Request.MOTION:
            return self._mirror.motion_record()
        if request is not Request.IDENTIFY:
            return None
        wrong = self.plan.holds(FaultKind.WRONG_VERSION)
        if wrong is None:
            return self.config.identity.pack()
        return replace(self.config.identity, protocol=(wrong.amount >> 8, wrong.amount & 0xFF)).pack()

    def _do(self, request: Request, argument: int, now: float) -> Result:
        if request is Request.HELLO and argument >> 8 == PROTOCOL_MAJOR:
            self._sweep.forget(now)
            self._mirror.reset_motion()
        if request is Request.CLEAR_FAULTS and self._session:
            self._mirror.faults &= ~BoardFault(argument & 0x7F)
        ends = request is Request.GOODBYE or (request is Request.LASER and not argument)
        if ends or (request is Request.HALT and self._session):
            self._sweep.end(now)
        elif self._session and request >= Request.SWEEP_STEP:
            return self._do_sweep(request, argument & 0xFFFFFFFF, argument, now)
        elif self._session and self._sweep.running and request in (Request.LASER, Request.HOME, Request.GO_TO):
            return Result.BUSY
        return super()._do(request, argument, now)

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

    def _flags(self, instant: float) -> int:
        flags = super()._flags(instant)
        if self.config.identity.protocol < (1, 1):
            return flags
        flags |= int(BoardFlag.HAS_SWEEP)
        flags |= int(BoardFlag.COUNTS_EXPOSURES) if self.shutter.wired else 0
        return flags | (int(BoardFlag.SWEEPING | BoardFlag.MOVING) if self._sweep.running else 0)


def minor_of(request: Request) -> int:
    """First minor version of protocol 1 that has a request."""
    if request is Request.SWEEP_DARK:
        return 2
    return 1 if request >= Request.SWEEP_STEP else 0
