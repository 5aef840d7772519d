"""Emulated mirror unit: motor, home switch and position counting, with homing, motion and travel limits."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from drivers.board.protocol import BoardFlag, Result
from drivers.emulator.config import EmulatorConfig


@dataclass(frozen=True, slots=True)
class Segment:
    """Part of a motion at constant speed, from step `origin` at time `start` [s] to step `target` at time `end` [s]."""

    start: float
    end: float
    origin: float
    target: float

    def at(self, time: float) -> float:
        """Return the position at `time` [steps]; before `start` and after `end`, that of the nearer end."""
        if time >= self.end:
            return self.target
        if time <= self.start:
            return self.origin
        return self.origin + (self.target - self.origin) * (time - self.start) / (self.end - self.start)


class Motor:
    """Stepper motor that moves at constant speed. It keeps the last few thousand segments of its motion.

    Attributes:
        speed: speed of the motor [steps/s].
        settle: settling time after a motion [s].
        still_at: time at which the last motion ends or has ended, including settling [s].
    """

    def __init__(self, speed: float, settle: float, overshoot: int, position: float, now: float) -> None:
        """Start at rest.

        Args:
            speed: speed of the motor [steps/s].
            settle: settling time after a motion [s].
            overshoot: number of steps by which a downward motion overshoots before it returns.
            position: true position [steps from the home switch].
            now: current time [s].
        """
        self.speed, self.settle, self._overshoot = speed, settle, overshoot
        self._segments: deque[Segment] = deque([Segment(now, now, position, position)], maxlen=4096)
        self.still_at = now

    def move(self, target: float, now: float) -> None:
        """Start a motion to position `target` at time `now`; it replaces the current motion."""
        start, origin = now, self.true_position(now)
        if target < origin:
            start = self._add(start, origin, target - self._overshoot)
            origin = target - self._overshoot
        self.still_at = self._add(start, origin, target) + self.settle

    def move_on(self, target: float) -> None:
        """Append a motion to position `target` to the current motion."""
        last = self._segments[-1]
        self.still_at = self._add(last.end, last.target, target) + self.settle

    def halt(self, now: float) -> None:
        """Stop at the current position."""
        position = self.true_position(now)
        self._cut(now)
        self._segments.append(Segment(now, now, position, position))
        self.still_at = now + self.settle

    def true_position(self, time: float) -> float:
        """Return the true position at `time` [steps from the home switch]."""
        for segment in reversed(self._segments):
            if segment.start <= time:
                return segment.at(time)
        return self._segments[0].origin

    def _add(self, start: float, origin: float, target: float) -> float:
        self._cut(start)
        end = start + abs(target - origin) / self.speed
        self._segments.append(Segment(start, end, origin, target))
        return end

    def _cut(self, now: float) -> None:
        while len(self._segments) > 1 and self._segments[-1].start >= now:
            self._segments.pop()


class MirrorUnit:
    """Emulated motor and home switch, and the firmware's knowledge of the position.

    Attributes:
        motions: number of motions started since power-up.
        home_error: error of the step count when the home switch was last found; always 0, as this motor loses no steps.
        homed: True if the home position is known.
    """

    home_error = 0

    def __init__(self, config: EmulatorConfig, now: float) -> None:
        """Start at the centre of the travel, with the home position unknown."""
        self._config, self._identity = config, config.identity
        centre = (self._identity.min_step + self._identity.max_step) // 2
        speed = config.mirror_speed / self._identity.step_angle
        self._motor = self._made_motor(speed, centre, now)
        self.power_on(now)

    def _made_motor(self, speed: float, position: float, now: float) -> Motor:
        return Motor(speed, self._config.settle, self._config.overshoot, position, now)

    def power_on(self, now: float) -> None:
        """Reset the firmware's state and stop the motor, as at power-up."""
        self._motor.halt(now)
        self.motions = 0
        self.homed = self._homing = False
        self._target: int | None = None
        self._under_way = False

    def ended(self, now: float) -> float | None:
        """If a motion has ended since the last call, return the time of its end, with settling [s]; otherwise None."""
        if not self._under_way or self.moving(now):
            return None
        self._under_way = False
        return self._motor.still_at

    def advance(self, now: float) -> None:
        """Complete a homing that has ended."""
        if not self._homing or now < self._motor.still_at:
            return
        self._homing = False
        self._come_home()

    def _come_home(self) -> None:
        self.homed = True

    def home(self, now: float) -> Result:
        """Start homing; BUSY if it is already running."""
        if self._homing:
            return Result.BUSY
        self.homed, self._homing = False, True
        self._begin(self._identity.min_step)
        self._motor.move(0.0, now)
        self._motor.move_on(self._identity.min_step)
        return Result.OK

    def go_to(self, step: int, now: float) -> Result:
        """Start a motion to `step`, unless it is the target already; if the result is not OK, nothing changes."""
        if self._homing:
            return Result.BUSY
        if not self.homed:
            return Result.NOT_HOMED
        if not self.reaches(step):
            return Result.OUT_OF_RANGE
        if step == self._target:
            return Result.OK
        self._begin(step)
        self._motor.move(step, now)
        return Result.OK

    def reaches(self, step: int) -> bool:
        """Return True if a step is within the travel."""
        return self._identity.min_step <= step <= self._identity.max_step

    def halt(self, now: float) -> None:
        """Stop the mirror at its current position, and abort homing."""
        if self.moving(now):
            self._motor.halt(now)
            self._target = None
        self._homing = False

    def moving(self, instant: float) -> bool:
        """Return True if the last motion, including settling, has not ended at time `instant` [s]."""
        return instant < self._motor.still_at

    @property
    def still_at(self) -> float:
        """Time at which the last motion ends or has ended, including settling [s]."""
        return self._motor.still_at

    def step(self, instant: float) -> int:
        """Return the position that the firmware reports [steps from the home switch]."""
        return round(self._motor.true_position(instant))

    def flags(self, instant: float) -> int:
        """Return the mirror's bits of the status flags."""
        flags = int(BoardFlag.MOVING) if self.moving(instant) else 0
        return flags | (int(BoardFlag.HOMED) if self.homed else 0)

    def true_angle(self, instant: float) -> float:
        """Return the true mirror angle [rad]."""
        return self._identity.angle_of(0) + self._motor.true_position(instant) * self._identity.step_angle

    def _begin(self, target: int) -> None:
        self.motions += 1
        self._target = target
        self._under_way = True
