"""The emulated mirror: where the motor really is at any time, with backlash overshoot, settling and lost steps."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Segment:
    """One segment of a motion, at constant speed: from `start` [s] at step `origin` to `end` [s] at step `target`."""

    start: float
    end: float
    origin: float
    target: float

    def at(self, time: float) -> float:
        """The position [steps] at `time`."""
        if time >= self.end:
            return self.target
        if time <= self.start:
            return self.origin
        return self.origin + (self.target - self.origin) * (time - self.start) / (self.end - self.start)


class Motor:
    """A stepper that moves at constant speed, in segments; keeps the last few thousand to answer for the past."""

    def __init__(self, speed: float, settle: float, overshoot: int, position: float, now: float) -> None:
        """Stand still.

        Args:
            speed: speed of the motor [steps/s].
            settle: time after a motion before the mirror is still [s].
            overshoot: steps by which a move down goes too far, to come back upwards.
            position: true position [steps from the home switch].
            now: present time [s].
        """
        self.speed, self.settle, self._overshoot = speed, settle, overshoot
        self._segments: deque[Segment] = deque([Segment(now, now, position, position)], maxlen=4096)
        self.still_at = now
        self.lost = 0.0
        """True position minus what the firmware believes [steps]."""

    def move(self, target: float, now: float) -> None:
        """Begin a motion to the believed position `target`, from wherever the motor is now."""
        start, origin = now, self.true_position(now)
        goal = target + self.lost
        if goal < origin:
            start = self._add(start, origin, goal - self._overshoot)
            origin = goal - self._overshoot
        self.still_at = self._add(start, origin, goal) + self.settle

    def move_on(self, target: float) -> None:
        """Add a further segment to the believed position `target` after the motion under way."""
        last = self._segments[-1]
        self.still_at = self._add(last.end, last.target, target + self.lost) + self.settle

    def lose(self, steps: float) -> None:
        """Let the motions to come fall short by `steps`, unknown to the firmware."""
        self.lost -= steps

    def halt(self, now: float) -> None:
        """Stop where the motor is."""
        position = self.true_position(now)
        self._cut(now)
        self._segments.append(Segment(now, now, position, position))
        self.still_at = now + self.settle

    def true_position(self, time: float) -> float:
        """Where the mirror really is at `time` [steps from the home switch]."""
        for segment in reversed(self._segments):
            if segment.start <= time:
                return segment.at(time)
        return self._segments[0].origin

    def believed_position(self, time: float) -> float:
        """Where the firmware believes the mirror to be [steps]."""
        return self.true_position(time) - self.lost

    def _add(self, start: float, origin: float, target: float) -> float:
        self._cut(start)
        end = start + abs(target - origin) / self.speed
        self._segments.append(Segment(start, end, origin, target))
        return end

    def _cut(self, now: float) -> None:
        while len(self._segments) > 1 and self._segments[-1].start >= now:
            self._segments.pop()
