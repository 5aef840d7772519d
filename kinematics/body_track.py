"""Pose of the body at any instant of a pause, from streamed joint positions and the standing feet.

The feet do not move on the ground, so the motion of the body since BEGIN follows from the positions of the soles in
`base_link`. The joint positions are smoothed around the instant by a parabola in time, weighted by distance in time.
A rigid motion is then fitted to the soles by generalised least squares, with each sole weighted by the noise of its leg
as in `stillness`. The bias of a joint is the same at BEGIN and at the instant, and cancels.
"""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from kinematics.arrays import Float, read_only
from kinematics.exceptions import ArgumentError, StanceError
from kinematics.model import RobotModel
from kinematics.stance import Stance
from kinematics.stillness import MOST_NOISE, StandingFeet, most_apart
from kinematics.transforms import transform_points
from kinematics.tree import RobotState

# Half width of the smoothing window [s]. For a sway at 2 Hz, the error of the parabola is 0.13 % of the amplitude.
HALF_WINDOW = 0.08
# Longest allowed gap between the samples before and after an instant [s]: three lost samples at 50 Hz.
LONGEST_GAP = 0.08
# Largest allowed standard deviation of an instant [s]. Over a longer time, the body may reverse its motion, whereas the
# covariance assumes a constant speed.
MOST_TIME_SIGMA = 0.015
# Least number of samples for a parabola: three to fit it and one to contradict it.
LEAST_SAMPLES = 4
# Number of newest samples kept when the buffer is full: a minute at 1 kHz.
MOST_SAMPLES = 60_000
# Number of iterations of the fit: at a rotation of 0.1 rad, the third changes the pose by less than a micrometre.
STEPS = 3


@dataclass(frozen=True, slots=True, eq=False)
class BodyPlace:
    """Pose of the body at one instant, relative to BEGIN; arrays are read-only.

    Attributes:
        transform_base_to_begin: (4, 4) from `base_link` at the instant to `base_link` at BEGIN.
        covariance: (6, 6) covariance of this motion, REP-103 order in `base_link`: translation of the optical centre
            [m], rotation [rad]. Errors that all instants of a pause share, such as the noise of BEGIN's joints, are
            excluded.
        state: state of the robot with the smoothed joint positions.
    """

    transform_base_to_begin: Float
    covariance: Float
    state: RobotState


class BodyTrack:
    """Poses of the body during one pause; samples may be added from any thread."""

    def __init__(
        self, robot: RobotModel, stance: Stance, *, transform_camera_to_base: npt.ArrayLike | None = None
    ) -> None:
        """Start with the stance of BEGIN, to which all poses are relative.

        Args:
            robot: model of the robot.
            stance: stance of BEGIN.
            transform_camera_to_base: (4, 4) calibrated pose of the camera; None = the pose in the URDF.

        Raises:
            ArgumentError: the matrix is not a transform.
            StanceError: fewer than three feet carry the body, or they are on a line.
            UnknownName, JointPositionError: the stance does not fit this robot.
        """
        self._robot, self._stance, self._camera = robot, stance, robot.optical_centre(transform_camera_to_base)
        self._feet: dict[tuple[str, ...], StandingFeet] = {}
        self._feet_of(stance.support_feet)
        self._begin = robot.state(stance.joint_positions)
        # Each row is a sample: time, joints and supports. The first `_end` rows are filled.
        self._rows: Float = np.zeros((0, 1 + len(self._begin.positions) + len(robot.legs)))
        self._end = 0
        self._lock = threading.Lock()

    def add(self, times: npt.ArrayLike, joint_positions: npt.ArrayLike, supports: npt.ArrayLike) -> None:
        """Add n samples.

        Args:
            times: (n,) strictly ascending and later than all earlier samples [s], on any one clock.
            joint_positions: (n, j) in the order of the robot's joints [rad].
            supports: (n, l) True for a leg that carries weight, in the order of the robot's legs.

        Raises:
            ArgumentError: an array has the wrong shape, a value is not finite, or times do not ascend.
        """
        times, joints = np.array(times, dtype=np.float64), np.array(joint_positions, dtype=np.float64)
        carry = np.array(supports, dtype=bool)
        wanted = (times.size, len(self._begin.positions)), (times.size, len(self._robot.legs))
        if times.ndim != 1 or (joints.shape, carry.shape) != wanted:
            raise ArgumentError(
                f"times, joints and supports have shapes {times.shape}, {joints.shape}, {carry.shape}; allowed: "
                f"(n,), (n, {wanted[0][1]}), (n, {wanted[1][1]})"
            )
        if not (np.isfinite(times).all() and np.isfinite(joints).all()):
            raise ArgumentError("times and joint_positions must be finite")
        with self._lock:
            if (np.diff(np.append(self._rows[: self._end, 0][-1:], times)) <= 0.0).any():
                raise ArgumentError("times must ascend: each sample must be later than the one before")
            end = self._end + len(times)
            if end > len(self._rows):
                kept = self._rows[: self._end][-MOST_SAMPLES:]
                end = len(kept) + len(times)
                # Because the buffer doubles, each sample is copied only once on average.
                self._rows = np.concatenate((kept, np.empty((end + len(times), self._rows.shape[1]))))
            self._rows[end - len(times) : end] = np.column_stack((times, joints, carry))
            self._end = end

    @property
    def latest(self) -> float:
        """Time of the latest sample [s]; -inf without one."""
        with self._lock:
            return float(self._rows[self._end - 1, 0]) if self._end else -math.inf

    def covers(self, time: float) -> bool:
        """Test whether the pose at a time [s] is final, so that later samples cannot change it."""
        return self.latest >= time + HALF_WINDOW

    def longest_gap(self, start: float, end: float) -> float:
        """Longest gap between samples from `start` to `end`, including the smoothing windows around both [s].

        Infinite if the samples do not extend over the interval and both windows.
        """
        with self._lock:
            times = self._rows[: self._end, 0]
        first = int(np.searchsorted(times, start - HALF_WINDOW, side="right")) - 1
        last = int(np.searchsorted(times, end + HALF_WINDOW))
        if first < 0 or last >= len(times):
            return math.inf
        return float(np.diff(times[first : last + 1]).max(initial=0.0))

    def at(self, time: float, time_sigma: float = 0.0) -> BodyPlace | None:
        """Compute the pose of the body at a time.

        Args:
            time: instant on the clock of the samples [s].
            time_sigma: standard deviation of `time` [s].

        Returns:
            The pose; None if samples around the time are missing, if fewer than three of BEGIN's feet stand in all of
            these samples or they are on a line, if these feet moved relative to each other, if the joints deviate too
            much from a parabola, or if the time is too uncertain (`MOST_TIME_SIGMA`).
        """
        samples = self._window(time)
        if samples is None or not time_sigma <= MOST_TIME_SIGMA:
            return None
        since, joints = samples[:, 0] - time, samples[:, 1 : 1 + len(self._begin.positions)]
        weights = (1.0 - np.abs(since / HALF_WINDOW) ** 3) ** 3
        parabola = np.stack((np.ones_like(since), since, since**2), axis=1)
        gains: Float = np.asarray(
            np.linalg.solve(parabola.T @ (weights[:, None] * parabola), parabola.T * weights), np.float64
        )
        smoothed, rates, bends = gains @ joints
        residual = (joints - parabola @ (smoothed, rates, bends)) / self._robot.tree.joint_scales
        stated = self._robot.noise.encoder_noise**2
        noise = float(np.sum(weights[:, None] * residual**2)) / (joints.shape[1] * _freedom(parabola, weights, gains))
        carries: list[bool] = np.all(samples[:, 1 + joints.shape[1] :], axis=0).tolist()
        standing = dict(zip(self._robot.legs, carries, strict=True))
        names = tuple(foot for foot in self._stance.support_feet if standing[foot])
        if noise > MOST_NOISE**2 * stated or len(names) < 3:
            return None
        try:
            feet = self._feet_of(names)
        except StanceError:
            return None
        variance = max(noise, stated)
        share = float(gains[0] @ gains[0])
        state = self._robot.state(smoothed)
        transform, apart = self._fit(feet, state)
        if apart > most_apart(len(feet.residual)) * variance * (1.0 + share):
            return None
        rate = feet.motion @ rates
        covariance = variance * share * feet.covariance + time_sigma**2 * np.outer(rate, rate)
        return BodyPlace(read_only(transform), read_only(covariance), state)

    def _window(self, time: float) -> Float | None:
        """Samples in the smoothing window around a time, one per row; None if too many are missing."""
        with self._lock:
            rows = self._rows[: self._end]
        first, after, end = np.searchsorted(rows[:, 0], (time - HALF_WINDOW, time, time + HALF_WINDOW)).tolist()
        if end - first < LEAST_SAMPLES or not first < after < end:
            return None
        return None if rows[after, 0] - rows[after - 1, 0] > LONGEST_GAP else rows[first:end]

    def _feet_of(self, names: tuple[str, ...]) -> StandingFeet:
        if names not in self._feet:
            self._feet[names] = StandingFeet(self._robot, self._stance, names, self._camera)
        return self._feet[names]

    def _fit(self, feet: StandingFeet, state: RobotState) -> tuple[Float, float]:
        """Motion (4, 4) that maps the soles to their positions at BEGIN, and chi^2 of the residual for sigma = 1."""
        import pinocchio

        begin, now = self._begin.soles_in_base(feet.names), state.soles_in_base(feet.names)
        transform = np.eye(4)
        for _ in range(STEPS):
            left = feet.whitened_soles(transform_points(transform, now) - begin)
            step = feet.inverse @ left
            turn = np.eye(4)
            turn[:3, :3] = pinocchio.exp3(step[3:])
            turn[:3, 3] = step[:3] + self._camera - turn[:3, :3] @ self._camera
            transform = turn @ transform
        left = feet.whitened_soles(transform_points(transform, now) - begin)
        return transform, float(left @ left)


def _freedom(parabola: Float, weights: Float, gains: Float) -> float:
    """Expected weighted sum of squared residuals of one joint for sigma = 1."""
    hat = np.eye(len(weights)) - parabola @ gains
    return max(float(np.sum(weights[:, None] * hat**2)), math.ulp(1.0))
