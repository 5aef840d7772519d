"""Mirror of the bench board: sweeps, adjustable speed, and faults (lost steps, missing home switch, endless motion)."""

from __future__ import annotations

from drivers.board.board_records import seal
from drivers.board.protocol import BoardFault, Request, Result
from drivers.board.sweep_records import MOTION
from drivers.emulator.config import EmulatorConfig
from drivers.emulator.mirror import MirrorUnit, Motor
from testbed.bench_board.faults import FaultKind, FaultPlan

# Acceleration of a motor that starts at its top speed [steps/s^2].
FREE = 4_000_000_000


class LossyMotor(Motor):
    """Stepper that can lose steps.

    Attributes:
        lost: true position minus the firmware's position [steps].
    """

    lost = 0.0

    def move(self, target: float, now: float) -> None:
        """Start a motion to the position `target` according to the firmware."""
        super().move(target + self.lost, now)

    def move_on(self, target: float) -> None:
        """Append a segment to the position `target` according to the firmware to the current motion."""
        super().move_on(target + self.lost)

    def believed_position(self, time: float) -> float:
        """Position according to the firmware [steps]."""
        return self.true_position(time) - self.lost


class BenchMirror(MirrorUnit):
    """Motor, home switch, and the firmware's estimate of the position, with faults.

    Attributes:
        faults: faults that are set.
    """

    _motor: LossyMotor

    def __init__(self, config: EmulatorConfig, plan: FaultPlan, now: float) -> None:
        """Start at the centre of the travel, not homed."""
        self._plan = plan
        super().__init__(config, now)

    def power_on(self, now: float) -> None:
        """Start as after a reset."""
        self.reset_motion()
        super().power_on(now)
        self.faults = BoardFault(0)
        self.home_error = 0

    def motion_record(self) -> bytes:
        """Motion profile, as sent by the board, of a motor that starts at its top speed."""
        speed = round(self._motor.speed)
        return seal(MOTION.pack(speed, speed, FREE, round(self._motor.settle * 1e6), self._config.overshoot, 0))

    def reset_motion(self) -> None:
        """Restore the configured speed and settling time."""
        self._motor.speed = self._config.mirror_speed / self._identity.step_angle
        self._motor.settle = self._config.settle

    def set_motion(self, request: Request, value: int, now: float) -> Result:
        """Set the top speed [steps/s] or the settling time [us]; the emulated motor has no ramp."""
        if value < 1 or request not in (Request.TOP_SPEED, Request.SETTLE):
            return Result.OUT_OF_RANGE
        if self.moving(now):
            return Result.BUSY
        if request is Request.TOP_SPEED:
            self._motor.speed = float(value)
        else:
            self._motor.settle = value * 1e-6
        return Result.OK

    def sweep_to(self, step: int, now: float) -> None:
        """Move to the next stripe of a sweep; not counted as a motion."""
        self._target = step
        self._motor.move(step, now)

    def count_motion(self) -> None:
        """Count a motion that is about to start."""
        self.motions += 1
        self._under_way = False

    def halt_sweep(self, now: float) -> None:
        """Stop during a sweep; reported after settling."""
        self._under_way = self.moving(now)
        self.halt(now)

    def moving(self, instant: float) -> bool:
        """True if the mirror was moving or settling at a time [s], or is jammed."""
        jammed = self.motions > 0 and self._plan.holds(FaultKind.JAMMED) is not None
        return jammed or super().moving(instant)

    def home(self, now: float) -> Result:
        """Start homing, which reveals the steps lost before."""
        if not self._homing:
            self.home_error = round(-self._motor.lost) if self.homed else 0
            self._motor.lost = 0.0
        return super().home(now)

    def step(self, instant: float) -> int:
        """Step according to the firmware."""
        return round(self._motor.believed_position(instant))

    def believed_angle(self, instant: float) -> float:
        """Mirror angle according to the firmware [rad]."""
        position = self._motor.believed_position(instant)
        return self._identity.angle_of(0) + position * self._identity.step_angle

    def _made_motor(self, speed: float, position: float, now: float) -> LossyMotor:
        return LossyMotor(speed, self._config.settle, self._config.overshoot, position, now)

    def _come_home(self) -> None:
        if self._plan.holds(FaultKind.NO_HOME_SWITCH):
            self.faults |= BoardFault.HOME_NOT_FOUND
            return
        super()._come_home()
        if abs(self.home_error) > 1:
            self.faults |= BoardFault.LOST_STEPS

    def _begin(self, target: int) -> None:
        loss = None if self._homing else self._plan.strike(Request.GO_TO, (FaultKind.LOST_STEP,))
        if loss is not None:
            self._motor.lost -= loss.amount
        super()._begin(target)
