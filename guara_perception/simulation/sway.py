"""Simulated sway of a robot over its feet, and the stream of joint readings that it produces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from guara_perception.arrays import Float
from guara_perception.exceptions import InvalidInput
from kinematics import RobotModel, Stance

# Sigma of the white noise of a joint reading, and sigma of a joint's bias, which is constant during a pause [rad].
WHITE_RAD, BIAS_RAD = np.radians(0.05), np.radians(0.2)


@dataclass(frozen=True)
class Sway:
    """Motion of the body over its feet, from the scan posture at time 0.

    Attributes:
        turn: root sum of squares of the amplitudes of pitch and roll [rad]; the amplitude of the roll is half that of
            the pitch.
        shift: root sum of squares of the amplitudes of the shift along x, y and z [m].
        frequency: frequency of the pitch [1/s]; roll and shift are slower, so that the motion repeats only after
            several periods.
        speed: constant additional speed along x [m/s].
    """

    turn: float
    shift: float
    frequency: float
    speed: float = 0.0

    def at(self, time: float) -> Float:
        """Pose (4, 4) of `base_link` at a time [s], in `base_link` at time 0."""
        one, other = (np.sin(2.0 * np.pi * self.frequency * rate * time) for rate in (1.0, 0.8))
        transform = np.eye(4)
        pitch_roll = self.turn * np.array([0.5 * other, one, 0.0]) / np.hypot(1.0, 0.5)
        transform[:3, :3] = Rotation.from_rotvec(pitch_roll).as_matrix()
        transform[:3, 3] = self.shift * other * np.array([0.5, 0.5, np.sqrt(0.5)])
        transform[0, 3] += self.speed * time
        return transform

    def joints_at(self, robot: RobotModel, time: float) -> Float:
        """True joint positions (j,) [rad] at a time [s]; raises the errors of `joints_of`."""
        return joints_of(robot, self.at(time))


def joints_of(robot: RobotModel, transform_base_to_begin: Float) -> Float:
    """True joint positions (j,) [rad] after a motion of the body from the scan posture over fixed soles.

    Raises:
        InvalidInput: a sole is out of reach of its leg.
    """
    state = robot.state(robot.posture(robot.config.scan_posture))
    joints = np.array(state.positions)
    soles = state.soles_in_base(robot.legs)
    moved = (soles - transform_base_to_begin[:3, 3]) @ transform_base_to_begin[:3, :3]
    # A flat sole stays level on the ground, so its pitch in base_link is minus the pitch of the body.
    pitch = np.arcsin(transform_base_to_begin[2, 0])
    for leg, sole in zip(robot.legs, moved, strict=True):
        reach = robot.reach(leg, sole, pitch)
        if not np.all(reach.is_reachable):
            shift = np.round(transform_base_to_begin[:3, 3], 4).tolist()
            raise InvalidInput(
                f"leg {leg!r} does not reach its foothold with the body moved by {shift} m: reduce the sway"
            )
        for name, angle in zip(robot.tree.leg(leg).joints, np.ravel(reach.joint_positions).tolist(), strict=True):
            joints[robot.tree.joint_index(name)] = angle
    return joints


def stream_of(
    robot: RobotModel,
    sway: Sway,
    times: Float,
    rng: np.random.Generator,
    *,
    begin: float = 0.0,
    white: float = WHITE_RAD,
    bias: float = BIAS_RAD,
) -> tuple[Float, Stance]:
    """Joint readings (n, j) at times (n,) [s], and the stance read at time `begin` [s].

    The white noise is independent in each reading; the bias of each joint is the same in all readings.

    Args:
        robot: the robot, in the scan posture at time 0.
        sway: motion of the body.
        times: (n,) times of the readings [s].
        rng: source of the noise.
        begin: time of the stance [s].
        white: sigma of the white noise of one reading [rad].
        bias: sigma of the bias of a joint [rad].

    Raises:
        InvalidInput: a sole is out of reach of its leg.
    """
    true = np.array([sway.joints_at(robot, time) for time in times.tolist()])
    off = rng.normal(0.0, bias, true.shape[1])
    first = sway.joints_at(robot, begin) + off + rng.normal(0.0, white, true.shape[1])
    stance = Stance(dict(zip(robot.tree.joint_names, first.tolist(), strict=True)), robot.legs, None)
    return true + off + rng.normal(0.0, white, true.shape), stance
