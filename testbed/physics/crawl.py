"""Statically stable crawl under force control: standing feet support and move the body, and one foot swings.

No joint is position-controlled, so feet do not push against each other. The wrench of the body is distributed to the
standing feet as the smallest forces inside their friction cones, and joint torques follow from the legs' Jacobians.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
from scipy.optimize import nnls

from guara_perception.arrays import Float
from testbed.physics.mujoco_robot import STEP_S
from testbed.physics.robot import LEGS, Robot

GRAVITY = 9.81
# Number of simulation steps per command.
HELD_STEPS = 2
TICK_S = HELD_STEPS * STEP_S
# Gains of the control of the body: position [1/s^2] and velocity [1/s].
PULL, BRAKE = 80.0, 18.0
# Gains of the control of the attitude: rotation [Nm/rad] and angular velocity [Nms/rad].
TURN_PULL, TURN_BRAKE = np.array([120.0, 160.0, 100.0]), np.array([10.0, 12.0, 8.0])
# Weights of errors of force and moment, and costs of contact forces along x, y and z.
WRENCH_WEIGHT = np.array([1.0, 1.0, 1.0, 20.0, 20.0, 20.0])
COST = np.array([0.032, 0.032, 0.010])
FRICTION_USED, LEAST_LOAD_N = 0.5, 5.0
# Edges of the linearised friction cone of a foot.
EDGES = np.array([[1.0, -1, 0, 0], [0, 0, 1, -1], [1, 1, 1, 1]]) * np.array([[FRICTION_USED], [FRICTION_USED], [1.0]])
FROZEN_PULL, FROZEN_BRAKE = 200.0, 8.0
NEAR_M, DEEPER_M = 0.015, 0.04
SWING_M_S, LOWER_M_S, BODY_M_S = 0.30, 0.10, 0.12
SHIFT_S, UNLOAD_S, LOAD_S, SETTLE_S, FROZEN_S = 0.7, 0.15, 0.25, 0.20, 0.20
TOUCH_N, BUMP_N = 6.0, 15.0
FALLEN_UP, FALLEN_M = 0.7, 0.10
# Leg, position, velocity and acceleration of a swinging foot.
Swing = tuple[int, Float, Float, Float]


class Fell(Exception):
    """The robot has fallen."""


class NoGround(Exception):
    """A foot was lowered without finding ground, and has returned to its old foothold."""


def turned(pitch: float, roll: float = 0.0, yaw: float = 0.0) -> Float:
    """Rotation (3, 3) by roll, then pitch, then yaw [rad]."""
    (cp, cr, cy), (sp, sr, sy) = np.cos([pitch, roll, yaw]), np.sin([pitch, roll, yaw])
    z, y = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]]), np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    return np.asarray(z @ y @ np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]]))


def turn_to(wanted: Float, actual: Float) -> Float:
    """Rotation vector (3,) in the world from one attitude to another, for small rotations [rad]."""
    e = wanted @ actual.T
    return 0.5 * np.array([e[2, 1] - e[1, 2], e[0, 2] - e[2, 0], e[1, 0] - e[0, 1]])


def shared(arms: Float, wrench: Float, shares: Float) -> Float:
    """Distribute a wrench about the centre of mass to the feet as the smallest forces (n, 3).

    Args:
        arms: (n, 3) positions of the feet relative to the centre of mass [m].
        wrench: (6,) force [N] and moment [Nm].
        shares: (n,) loading of each foot, from 0 (unloaded) to 1.
    """
    n = len(arms)
    to_wrench, to_force = np.zeros((6, 3 * n)), np.kron(np.eye(n), EDGES)
    for i, (x, y, z) in enumerate(arms):
        to_wrench[:3, 3 * i : 3 * i + 3] = np.eye(3)
        to_wrench[3:, 3 * i : 3 * i + 3] = [[0, -z, y], [z, 0, -x], [-y, x, 0]]
    least = np.zeros(3 * n)
    least[2::3] = np.minimum(LEAST_LOAD_N, 10 * LEAST_LOAD_N * shares)
    costs = (COST / np.maximum(shares, 1e-3)[:, None]).ravel()
    rows = np.concatenate((WRENCH_WEIGHT[:, None] * (to_wrench @ to_force), costs[:, None] * to_force))
    wanted = np.concatenate((WRENCH_WEIGHT * (wrench - to_wrench @ least), np.zeros(3 * n)))
    return np.asarray((least + to_force @ nnls(rows, wanted)[0]).reshape(n, 3))


class Crawl:
    """Controller that moves a robot step by step."""

    def __init__(self, robot: Robot) -> None:
        """Let a standing robot settle."""
        self.robot = robot
        self._com, self._rotation, self._shares = robot.com, np.eye(3), np.ones(4)
        self._hold(0.5)

    def freeze(self) -> None:
        """Hold still for a scan: joint positions are held, in addition to the torques that support the body."""
        robot, carried = self.robot, self._torques(np.array([0, 0, self.robot.mass * GRAVITY, 0, 0, 0]), range(4))
        positions = robot.joint_positions
        for _ in range(round(FROZEN_S / TICK_S)):
            error = positions - robot.joint_positions
            robot.advance(carried + FROZEN_PULL * error - FROZEN_BRAKE * robot.joint_speeds, HELD_STEPS)

    def step(self, leg: int, way: Float, com: Float, rotation: Float, top: float) -> None:
        """Shift the body, swing a foot above the highest ground on its path until it touches the ground, and load it.

        Args:
            leg: index of the leg.
            way: (n, 3) path of the foot's lowest point [m]; the last point is the target, and only x and y of the
                others are used.
            com: (3,) centre of mass during the swing [m].
            rotation: (3, 3) attitude of the body during the swing.
            top: highest ground on the path [m].

        Raises:
            NoGround: there is no ground at the target.
            Fell: the robot has fallen.
        """
        self._shift(com, rotation)
        self._ramp(leg, 1.0, 0.0, UNLOAD_S)
        start, target = self.robot.feet[leg], way[-1]
        height = max(top, start[2], target[2]) + self.robot.clearance
        try:
            self._lower(leg, self._carry(leg, way[1:], height), target)
        except NoGround:
            # Return to the old foothold along the same path.
            self._lower(leg, self._carry(leg, np.array([*way[-2:0:-1], start]), height), start)
            self._ramp(leg, 0.0, 1.0, LOAD_S)
            raise
        self._ramp(leg, 0.0, 1.0, LOAD_S)
        self._hold(SETTLE_S)

    def _tick(
        self, com: Float, speed: Float, rotation: Float, turn: Float, swing: tuple[int, Float, Float, Float] | None
    ) -> None:
        """Execute one command for the body and, if given, for a swinging foot."""
        robot = self.robot
        actual = robot.rotation
        force = PULL * (com - robot.com) + BRAKE * (speed - robot.data.subtree_linvel[robot.body])
        moment = TURN_PULL * turn_to(rotation, actual) + TURN_BRAKE * (turn - robot.turn_rate)
        wrench = np.concatenate((robot.mass * (force + (0, 0, GRAVITY)), moment))
        torques = self._torques(wrench, [i for i in range(4) if swing is None or i != swing[0]])
        if swing is not None:
            torques += robot.moving(*swing)
        robot.advance(torques, HELD_STEPS)
        if actual[2, 2] < FALLEN_UP or robot.base[2] - robot.feet[:, 2].mean() < FALLEN_M:
            raise Fell("the body tipped over or lies on the ground")

    def _torques(self, wrench: Float, standing: Iterable[int]) -> Float:
        """Joint torques with which the standing feet exert a wrench on the body."""
        robot, legs = self.robot, list(standing)
        torques = robot.data.qfrc_bias[robot.dofs] + robot.levelling(legs)
        for leg, force in zip(legs, shared(robot.feet[legs] - robot.com, wrench, self._shares[legs]), strict=True):
            torques -= robot.jacobian(leg)[:, robot.dofs].T @ force
        return torques

    def _hold(self, seconds: float, swing: Swing | None = None) -> None:
        for _ in range(max(round(seconds / TICK_S), 1)):
            self._tick(self._com, np.zeros(3), self._rotation, np.zeros(3), swing)

    def _ramp(self, leg: int, first: float, last: float, seconds: float) -> None:
        """Load or unload a foot."""
        count = round(seconds / TICK_S)
        for share in first + (last - first) * (np.arange(count) + 1) / count:
            self._shares[leg] = share
            self._hold(TICK_S)

    def _shift(self, com: Float, rotation: Float) -> None:
        """Move the body with all feet on the ground."""
        start, first, turn = self._com, self._rotation, turn_to(rotation, self._rotation)
        seconds = max(SHIFT_S, 0.95 * float(np.linalg.norm(com - start)) / BODY_M_S)
        for share, rate, _ in _smooth(seconds):
            partly = turned(turn[1] * share, turn[0] * share, turn[2] * share) @ first
            self._tick(start + share * (com - start), rate * (com - start), partly, rate * turn, None)
        self._com, self._rotation = com, rotation

    def _carry(self, leg: int, way: Float, height: float) -> Float:
        """Lift a foot and move it along a path, higher if it bumps into something; return the position reached."""
        start = self.robot.feet[leg]
        above = np.array([*start[:2], height])
        self._move(leg, start, above)
        for place in way:
            over = np.array([*place[:2], above[2]])
            for _ in range(3):
                bumped = self._move(leg, above, over, stops=True)
                if bumped is None:
                    break
                above, over = bumped + (0, 0, self.robot.clearance), over + (0, 0, self.robot.clearance)
                self._move(leg, bumped, above)
            above = over
        return above

    def _move(self, leg: int, begin: Float, end: Float, stops: bool = False) -> Float | None:
        """Move a foot on a straight line. With `stops`, stop at an obstacle and return the position there."""
        way = end - begin
        for share, rate, change in _smooth(max(1.5 * float(np.linalg.norm(way)) / SWING_M_S, 0.1)):
            place = begin + share * way
            self._hold(TICK_S, (leg, place, rate * way, change * way))
            if stops and self.robot.load(leg) > BUMP_N:
                return self.robot.feet[leg]
        return None

    def _lower(self, leg: int, above: Float, target: Float) -> None:
        """Lower a foot, fast at first, until it touches the ground."""
        near = np.array([*target[:2], target[2] + NEAR_M])
        if above[2] > near[2]:
            self._move(leg, above, near)
        for z in np.arange(near[2], target[2] - DEEPER_M, -LOWER_M_S * TICK_S):
            self._hold(TICK_S, (leg, np.array([*target[:2], z]), np.array([0, 0, -LOWER_M_S]), np.zeros(3)))
            if self.robot.load(leg) > TOUCH_N:
                return
        raise NoGround(f"{LEGS[leg]} found no ground")


def _smooth(seconds: float) -> Iterator[tuple[float, float, float]]:
    """Yield the progress (0 ... 1) of a minimum-jerk motion at each tick, with its first and second time derivative."""
    count = max(round(seconds / TICK_S), 1)
    for s in (np.arange(count) + 1) / count:
        rate, change = 30 * s**2 * (1 - s) ** 2, 60 * s * (1 - s) * (1 - 2 * s)
        yield s**3 * (10 - 15 * s + 6 * s * s), rate / seconds, change / seconds**2
