"""Tells when the robot stands still enough to scan, and whether it stood still during the scan."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from kinematics.arrays import read_only
from kinematics.carried_gravity import turn_between
from kinematics.exceptions import ArgumentError, CameraMoved, JointPositionError, StanceError, unknown_name
from kinematics.model import RobotModel
from kinematics.stance import Stance
from kinematics.transforms import checked_transform


@dataclass(frozen=True, slots=True)
class PauseReport:
    """Whether the robot is in a stance pause, and if not, why.

    Attributes:
        is_pause: the robot stands still.
        reason: "" in a pause, else what is missing, with value and limit.
        still_for: how long all joints have been slow with the same feet down [s].
    """

    is_pause: bool
    reason: str
    still_for: float


class PauseDetector:
    """Watches joint speeds and contacts: a pause is when all joints have been slow for long enough on the same feet."""

    def __init__(self, robot: RobotModel) -> None:
        """Start with no reading: no pause."""
        self._robot = robot
        self._limits = robot.pause_limits
        self._time: float | None = None
        self._still_since: float | None = None
        self._feet: frozenset[str] | None = None

    def update(self, time: float, joint_velocities: Mapping[str, float], support_feet: Sequence[str]) -> PauseReport:
        """Take one reading.

        Args:
            time: time of the reading [s] since any fixed instant; later than that of the last reading.
            joint_velocities: joint name -> velocity [rad/s], every joint.
            support_feet: legs whose soles carry the body.

        Raises:
            ArgumentError: the time does not grow.
            UnknownName: a joint or leg that the robot does not have.
            JointPositionError: a velocity is missing or not finite.
        """
        if not np.isfinite(time) or (self._time is not None and time <= self._time):
            raise ArgumentError(f"time is {time}; it must be finite and later than the last reading ({self._time})")
        speeds = self._speeds(joint_velocities)
        feet = frozenset(self._robot.tree.leg(foot).name for foot in support_feet)
        self._time = time
        fastest = max(speeds, key=lambda joint: speeds[joint])
        if feet != self._feet or speeds[fastest] >= self._limits.joint_speed_limit:
            self._still_since = None
        self._feet = feet
        limits = self._limits
        if speeds[fastest] >= limits.joint_speed_limit:
            reason = f"joint {fastest} moves at {speeds[fastest]:.3f} rad/s, limit {limits.joint_speed_limit:g}"
            return PauseReport(False, reason, 0.0)
        if self._still_since is None:
            self._still_since = time
        still_for = time - self._still_since
        if len(feet) < limits.minimum_feet:
            return PauseReport(False, f"{len(feet)} feet carry the body, {limits.minimum_feet} are needed", still_for)
        if still_for < limits.hold_time:
            return PauseReport(False, f"still for {still_for:.3f} s, {limits.hold_time:g} s are needed", still_for)
        return PauseReport(True, "", still_for)

    def _speeds(self, joint_velocities: Mapping[str, float]) -> dict[str, float]:
        names = self._robot.joint_names
        for joint in joint_velocities:
            if joint not in names:
                raise unknown_name("joint", joint, names)
        missing = [joint for joint in names if joint not in joint_velocities]
        if missing:
            raise JointPositionError(f"no velocity for {', '.join(missing)}; all {len(names)} joints are needed")
        speeds = {joint: abs(float(joint_velocities[joint])) for joint in names}
        for joint, speed in speeds.items():
            if not np.isfinite(speed):
                raise JointPositionError(f"joint {joint}: velocity {joint_velocities[joint]} is not finite")
        return speeds


@dataclass(frozen=True, slots=True)
class CameraMotion:
    """How the camera moved between two readings of the joints.

    Attributes:
        translation: distance that the optical centre moved [m].
        rotation: angle by which the camera turned [rad].
        is_still: whether both are within the limits of robot.toml.
    """

    translation: float
    rotation: float
    is_still: bool


def camera_motion(
    robot: RobotModel, begin: Stance, end: Stance, *, transform_camera_to_base: npt.ArrayLike | None = None
) -> CameraMotion:
    """How the camera moved over the feet that carried the body throughout.

    The feet stand on the ground: how they seem to move in `base_link` is the body's own motion, reversed.

    Args:
        robot: the model.
        begin: the stance read before the scan.
        end: the stance read after it.
        transform_camera_to_base: (4, 4) calibrated placement; default the URDF's.

    Raises:
        StanceError: fewer than three feet carried the body at both readings.
    """
    feet = [foot for foot in begin.support_feet if foot in end.support_feet]
    if len(feet) < 3:
        raise StanceError(
            f"support_feet: {len(feet)} feet carried the body before and after ({', '.join(feet) or 'none'}); "
            "three are needed to tell whether the camera moved"
        )
    before = robot.state(begin.joint_positions).soles_in_base(feet)
    after = robot.state(end.joint_positions).soles_in_base(feet)
    camera = robot.transform_camera_to_base
    if transform_camera_to_base is not None:
        camera = read_only(checked_transform(transform_camera_to_base, "transform_camera_to_base"))
    rotation = turn_between(after, before)
    moved = rotation @ (camera[:3, 3] - after.mean(axis=0)) + before.mean(axis=0) - camera[:3, 3]
    # From the skew part: the arc cosine of the trace loses half its digits at small angles.
    sine = np.linalg.norm(
        [rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]]
    )
    angle = float(np.arctan2(sine, np.trace(rotation) - 1.0))
    translation = float(np.linalg.norm(moved))
    limits = robot.pause_limits
    still = translation <= limits.camera_translation_limit and angle <= limits.camera_rotation_limit
    return CameraMotion(translation, angle, still)


def check_camera_still(
    robot: RobotModel, begin: Stance, end: Stance, *, transform_camera_to_base: npt.ArrayLike | None = None
) -> CameraMotion:
    """As `camera_motion`, for a scan that must not be used when the camera moved.

    Raises:
        CameraMoved: the message gives both motions and their limits.
        StanceError: as `camera_motion`.
    """
    motion = camera_motion(robot, begin, end, transform_camera_to_base=transform_camera_to_base)
    if not motion.is_still:
        limits = robot.pause_limits
        raise CameraMoved(
            f"the camera moved by {1e3 * motion.translation:.2f} mm and {np.degrees(motion.rotation):.3f} degrees "
            f"during the scan; {1e3 * limits.camera_translation_limit:g} mm and "
            f"{np.degrees(limits.camera_rotation_limit):.3g} degrees are allowed: scan again"
        )
    return motion
