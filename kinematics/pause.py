"""Detection of stance pauses from joint velocities and foot contacts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from kinematics.exceptions import ArgumentError
from kinematics.model import RobotModel
from kinematics.tree import in_order, refuse_not_finite


@dataclass(frozen=True, slots=True)
class PauseReport:
    """Result of pause detection: a stance pause, or the reason why there is none yet.

    Attributes:
        is_pause: True if all conditions of a pause hold.
        reason: condition that does not hold, with value and limit; "" in a pause.
        still_for: time for which all joints have been slow and the supporting feet unchanged [s].
    """

    is_pause: bool
    reason: str
    still_for: float


class PauseDetector:
    """Detector of stance pauses, in which enough feet carry the body and all joints are slow for a minimum time.

    The supporting feet must not change during this time.
    """

    def __init__(self, robot: RobotModel) -> None:
        self._robot = robot
        self._limits = robot.pause_limits
        self._time: float | None = None
        self._still_since: float | None = None
        self._feet: frozenset[str] | None = None

    def update(self, time: float, joint_velocities: Mapping[str, float], support_feet: Sequence[str]) -> PauseReport:
        """Process one reading.

        Args:
            time: time of the reading on a clock with any epoch [s]; must be later than that of the last reading.
            joint_velocities: joint name -> velocity [rad/s], of a prismatic joint [m/s]; every joint.
            support_feet: legs whose soles carry the body.

        Raises:
            ArgumentError: the time is not finite or not later than the last one.
            UnknownName: a joint or leg that the robot does not have.
            JointPositionError: a velocity is missing or not finite.
        """
        if not np.isfinite(time) or (self._time is not None and time <= self._time):
            last = "" if self._time is None else f" and later than the last reading ({self._time})"
            raise ArgumentError(f"time is {time}; it must be finite{last}")
        names = self._robot.joint_names
        velocities = np.array(in_order(joint_velocities, names, "velocity"), np.float64)
        refuse_not_finite(velocities, names, "velocity")
        limits, speeds = self._limits, np.abs(velocities)
        most = limits.joint_speed_limit * self._robot.tree.joint_scales
        fastest = int((speeds / most).argmax())
        is_moving = bool(speeds[fastest] >= most[fastest])
        feet = frozenset(self._robot.tree.leg(foot).name for foot in support_feet)
        self._time = time
        if feet != self._feet or is_moving:
            self._still_since = None
        self._feet = feet
        if is_moving:
            unit = self._robot.tree.unit(fastest)
            reason = f"joint {names[fastest]} moves at {speeds[fastest]:.3f} {unit}/s, limit {most[fastest]:g}"
            return PauseReport(False, reason, 0.0)
        if self._still_since is None:
            self._still_since = time
        still_for = time - self._still_since
        if len(feet) < limits.minimum_feet:
            carry = "foot carries" if len(feet) == 1 else "feet carry"
            return PauseReport(False, f"{len(feet)} {carry} the body, {limits.minimum_feet} are needed", still_for)
        if still_for < limits.hold_time:
            return PauseReport(False, f"still for {still_for:.3f} s, {limits.hold_time:g} s are needed", still_for)
        return PauseReport(True, "", still_for)
