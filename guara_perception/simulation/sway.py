"""Robot that sways over its feet: where its body is, and what a stream of its joints says of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from guara_perception.arrays import Float
from guara_perception.exceptions import InvalidInput
from kinematics import RobotModel, Stance

# Noise of a joint: white of one reading, and constant bias, per reading and per pause [rad].
WHITE_RAD, BIAS_RAD = np.radians(0.05), np.radians(0.2)


@dataclass(frozen=True)
class Sway:
    """Motion of the body about the middle of its feet; at time 0 it is where it stands.

    Attributes:
        turn: amplitude of pitch, and of half as much roll [rad].
        shift: amplitude along x, y and z together [m].
        frequency: of the turn [1/s]; the shift is slower, so that the two do not come back together.
        speed: of a body that moves on along x over its feet [m/s].
    """

    turn: float
    shift: float
    frequency: float
    speed: float = 0.0

    def at(self, time: float) -> Float:
        """`base_link` at a time in `base_link` at time 0, (4, 4)."""
        one, other = (np.sin(2.0 * np.pi * self.frequency * rate * time) for rate in (1.0, 0.8))
        transform = np.eye(4)
        pitch_roll = self.turn * np.array([0.5 * other, one, 0.0]) / np.hypot(1.0, 0.5)
        transform[:3, :3] = Rotation.from_rotvec(pitch_roll).as_matrix()
        transform[:3, 3] = self.shift * other * np.array([0.5, 0.5, np.sqrt(0.5)])
        transform[0, 3] += self.speed * time
        return transform


def joints_of(robot: RobotModel, transform_base_to_begin: Float) -> Float:
    """True joints (j,) [rad] of a body that moved while its soles stay as in scan posture."""
    state = robot.state(robot.posture(robot.config.scan_posture))
    joints = np.array(state.positions)
    soles = state.soles_in_base(robot.legs)
    moved = (soles - transform_base_to_begin[:3, 3]) @ transform_base_to_begin[:3, :3]
    # A flat sole stays level on the ground; its pitch in base_link is the body's with the other sign.
    pitch = np.arcsin(transform_base_to_begin[2, 0])
    for leg, sole in zip(robot.legs, moved, strict=True):
        reach = robot.reach(leg, sole, pitch)
        if not np.all(reach.is_reachable):
            shift = np.round(transform_base_to_begin[:3, 3], 4).tolist()
            raise InvalidInput(f"the body sways by {shift} m, leg {leg!r} does not reach so far; allowed: less sway")
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
    """Readings (n, j) at times (n,) [s], with noise fresh in each, and the stance of BEGIN."""
    true = np.array([joints_of(robot, sway.at(time)) for time in times.tolist()])
    off = rng.normal(0.0, bias, true.shape[1])
    first = joints_of(robot, sway.at(begin)) + off + rng.normal(0.0, white, true.shape[1])
    stance = Stance(dict(zip(robot.tree.joint_names, first.tolist(), strict=True)), robot.legs, None)
    return true + off + rng.normal(0.0, white, true.shape), stance
