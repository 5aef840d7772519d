"""Statistical test of stillness over all joint readings of a pause.

The standing feet do not move on the ground, so a motion of the body shows in the joints. With J_i the Jacobian of sole
i, r_i its position relative to the camera and xi = (v, w) the camera's motion in `base_link`, a change dq of the joints
gives

    J_i dq = -(v + w x r_i) + J_i e,    e ~ N(0, sigma^2 I),

from which xi follows by generalised least squares. The bias of a joint is constant and cancels. At every reading, the
mean over the last 1, 2, 4 ... readings is compared with the mean of all earlier readings and with those of the
preceding and of the first window of the same length, to detect steps, pulses and ramps. The noise is estimated from the
residual, the part of dq that no motion of the body explains. Sway is a motion of the body and does not affect the
residual. A residual far above the noise means that feet moved.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np
import numpy.typing as npt

from kinematics.arrays import Float, read_only
from kinematics.exceptions import ArgumentError, CameraMoved, StanceError
from kinematics.footprint import skew
from kinematics.model import RobotModel
from kinematics.stance import Stance
from kinematics.tree import checked_positions

# Largest probability of a false alarm per pause, over all tests made in it.
FALSE_ALARMS = 0.003

# Longest window [readings]: 5 s at 50 Hz. Slower motions appear as a difference between the first and the last window.
LONGEST = 256

# Required probability of detecting a motion in a random direction, and the size of that motion [m, rad] with and
# without frequent readings.
POWER = 0.95
WITH_HOLD = (1.0e-3, math.radians(0.1))
WITHOUT_HOLD = (1.5e-3, math.radians(0.15))

# Shortest pulse that must be detected [s]; readings are frequent if at least OFTEN of them fall into it.
PULSE_S, OFTEN = 0.2, 3

# Longest window considered in dating the start of a motion [readings]: PULSE_S at 320 Hz.
MOST_NEEDED = 64

# Largest learned noise, as a multiple of encoder_noise in robot.toml: anything larger is not joint noise. After LEARNED
# changes, the learned noise is also used to test whether feet moved relative to each other.
MOST_NOISE, LEARNED = 4.0, 8
# Minimum noise assumed in that test [rad]: it moves the sole of a 0.3 m leg by 0.03 mm, which is not a slip.
LEAST_NOISE = 1e-4

# Weight of the noise stated in robot.toml [readings]: low, so that a few readings distinguish a noisier robot from a
# moving one.
PRIOR_READINGS = 1

# Added to J J^T [m^2/rad^2] to keep it regular for a stretched leg. In the scan posture of the stock robot guara, the
# eigenvalues of J J^T are 0.004 and more.
LEAST_LEVER = 1e-6


@dataclass(frozen=True, slots=True)
class CameraMotion:
    """Motion of the camera between two readings of the joints.

    Attributes:
        translation: distance moved by the optical centre [m].
        rotation: rotation angle of the camera [rad].
        is_still: True if no motion was detected: the camera's motion is within the limits of robot.toml or explained by
            noise, and the standing feet did not move relative to each other.
    """

    translation: float
    rotation: float
    is_still: bool


class StandingFeet:
    """Least-squares fit of the camera's motion to the joint changes of some standing feet, as matrices.

    Attributes:
        names: legs of the feet.
        motion: (6, n) matrix from joint changes to the camera's motion.
        whitened: (6, n) matrix from joint changes to the whitened motion.
        residual: (3 feet - 6, n) matrix from joint changes to the part that no motion of the camera explains.
        inverse: (6, 3 feet) matrix from whitened changes of the soles to the camera's motion.
        covariance: (6, 6) covariance of the motion, for sigma = 1.
        units: (2, directions) chi^2 of a unit translation and a unit rotation in each of `DIRECTIONS`, for sigma = 1.
    """

    def __init__(self, robot: RobotModel, begin: Stance, feet: Sequence[str], camera: Float) -> None:
        """Linearise at the stance of BEGIN.

        Raises:
            StanceError: there are fewer than three feet, or they are on a line.
            UnknownName, JointPositionError: joints or feet are not those of this robot, or a position is invalid.
        """
        if len(feet) < 3:
            raise StanceError(
                f"support_feet: {len(feet)} carried the body in all readings ({', '.join(feet) or 'none'}); "
                "three are needed to test whether the camera moved"
            )
        state = robot.state(begin.joint_positions)
        self.names = tuple(feet)
        self._whiten: list[Float] = []
        rows, by_joints = [], []
        for leg, sole in zip(feet, state.soles_in_base(feet), strict=True):
            jacobian = state.jacobian(state.tree.leg(leg).sole)[:3]
            by_noise = jacobian * state.tree.joint_scales
            whiten = np.linalg.inv(np.linalg.cholesky(by_noise @ by_noise.T + LEAST_LEVER * np.eye(3)))
            rows.append(whiten @ np.hstack([-np.eye(3), skew(sole - camera)]))
            by_joints.append(whiten @ jacobian)
            self._whiten.append(whiten)
        design, white = np.vstack(rows), np.vstack(by_joints)
        left, values, _ = np.linalg.svd(design)
        if values[-1] < 1e-6 * values[0]:
            raise StanceError(f"support_feet: {', '.join(feet)} are on a line; the camera's motion is not observable")
        self.inverse: Float = np.linalg.pinv(design)
        self.motion: Float = self.inverse @ white
        self.whitened: Float = left[:, :6].T @ white
        self.residual: Float = left[:, 6:].T @ white
        information = design.T @ design
        self.covariance: Float = np.linalg.inv(information)
        blocks = information[:3, :3], information[3:, 3:]
        self.units = np.array([np.einsum("ni,ij,nj->n", DIRECTIONS, block, DIRECTIONS) for block in blocks])

    def whitened_soles(self, changes: Float) -> Float:
        """Whitened changes (3 feet,) [rad] from changes of the soles (feet, 3) in `base_link` [m]."""
        return np.concatenate([whiten @ change for whiten, change in zip(self._whiten, changes, strict=True)])


class Stillness:
    """Sequential test that the camera stands still, over all readings of a pause in the order of arrival.

    A motion of the camera is reported if it exceeds the limits of robot.toml ([pause]) and noise does not explain it;
    at most a fraction `FALSE_ALARMS` of still pauses is reported. Feet that moved relative to each other are reported
    too.
    """

    def __init__(
        self, robot: RobotModel, stance: Stance, time: float, *, transform_camera_to_base: npt.ArrayLike | None = None
    ) -> None:
        """Start with the reading of BEGIN.

        Args:
            robot: the model.
            stance: the stance of BEGIN.
            time: stamp of the joint reading on the gait's clock [s].
            transform_camera_to_base: (4, 4) calibrated pose of the camera; None = the pose in the URDF.

        Raises:
            ArgumentError: `time` is not finite, or the matrix is not a transform.
            UnknownName, JointPositionError: the joints of the stance are not those of this robot, or a position is
                invalid.
        """
        self._robot, self._begin = robot, stance
        self._camera = robot.optical_centre(transform_camera_to_base)
        self._first = checked_positions(robot.tree, stance.joint_positions)
        self._last = self._first
        self._names = stance.support_feet
        self._feet: StandingFeet | None = None
        # Row k is the sum of the joint changes since BEGIN over the first k readings. BEGIN is the first reading and
        # has a change of zero. In a long pause, `_add_sum` drops rows in the middle.
        self._sums = np.zeros((4 * LONGEST, len(self._first)))
        self._row = self._count = 1
        self._times = deque([_checked_time(time)], maxlen=2 * LONGEST + 1)
        self._head_times = [self._times[0]]
        self._energies: deque[float] = deque(maxlen=2 * LONGEST)
        self._variance = robot.noise.encoder_noise**2
        self._motion = ""
        self._still_until = -math.inf
        self._latest = np.zeros(6)

    def add(self, time: float, stance: Stance) -> None:
        """Add a reading of HOLD or END.

        A repetition of the last reading (same stamp, same joints) carries no information and is ignored.

        Raises:
            ArgumentError: `time` is not finite.
            StanceError: fewer than three feet carried the body in all readings, or these feet are on a line.
            UnknownName, JointPositionError: joints or supporting feet are not those of this robot, or a position is
                invalid.
        """
        positions, time = checked_positions(self._robot.tree, stance.joint_positions), _checked_time(time)
        names = tuple(foot for foot in self._names if foot in stance.support_feet)
        if self._feet is None or names != self._names:
            self._feet = StandingFeet(self._robot, self._begin, names, self._camera)
            self._names = names
            self._energies.clear()
        if time == self._times[-1] and np.array_equal(positions, self._last):
            return
        self._learn(self._feet, positions - self._last)
        self._last = positions
        self._add_sum(positions - self._first)
        self._times.append(time)
        if len(self._head_times) < LONGEST:
            self._head_times.append(time)
        self._test(self._feet)

    @property
    def motion(self) -> str:
        """One-line description of the first detected motion of the camera or of standing feet; empty without one."""
        return self._motion

    @property
    def still_until(self) -> float:
        """Stamp until which the readings show that the camera stood still [s].

        -inf before a second reading, and if the second reading already shows a motion.

        A motion that began earlier is detected with at least probability `POWER` if it has the size `WITH_HOLD` (for
        frequent readings) or `WITHOUT_HOLD`, unless `undetectable` states a larger size.
        """
        return self._still_until

    @property
    def undetectable(self) -> str:
        """Reason why motions of 1 mm or 0.1 degrees cannot be detected in this pause.

        Empty if such motions can be detected, and before a second reading.
        """
        window = self._recent()
        scales = np.arange(1.0, 20.05, 0.1)
        if self._feet is None or (seen := self._power(window, WITH_HOLD, scales) >= POWER)[0]:
            return ""
        scale = scales[np.argmax(seen)] if seen.any() else scales[-1]
        least = "only" if seen.any() else "not even"
        more = "send HOLD more often" if self._count > 2 else "send HOLD"
        return (
            f"joints too noisy ({math.degrees(math.sqrt(self._variance)):.3f} degrees per reading) to detect 1 mm or "
            f"0.1 degrees in this pause, {least} {scale:.1f} mm or {0.1 * scale:.2f} degrees: {more}"
        )

    @property
    def covariance(self) -> Float:
        """Covariance (6, 6) of the camera's motion as estimated from the readings.

        REP-103 order in `base_link` (translation of the optical centre [m], rotation [rad]). The estimate is the mean
        over the shortest pulse that must be detected (`PULSE_S`) compared with all earlier readings; before a second
        reading, it is the difference between two single readings.

        Raises:
            StanceError: before a second reading, if there are fewer than three feet or they are on a line.
            UnknownName: before a second reading, if a supporting foot is not a leg of this robot.
        """
        feet = self._feet or StandingFeet(self._robot, self._begin, self._names, self._camera)
        window = self._recent()
        return read_only(self._variance * (1 / window + 1 / max(self._count - window, 1)) * feet.covariance)

    def between_first_and_last(self) -> CameraMotion:
        """Motion of the camera between BEGIN and the last reading."""
        shift, turn = np.linalg.norm(self._latest[:3]), np.linalg.norm(self._latest[3:])
        return CameraMotion(float(shift), float(turn), not self._motion)

    def _learn(self, feet: StandingFeet, change: Float) -> None:
        """Update the estimate of the white noise with one joint change; the value of robot.toml is its minimum."""
        stated = self._robot.noise.encoder_noise**2
        self._energies.append(float(np.sum((feet.residual @ change) ** 2)) / 2.0)
        degrees = len(feet.residual)
        # Estimated from the median of chi^2 (approximation of Wilson and Hilferty), so that a foot that slips in a few
        # readings does not count as noise.
        found = float(np.median(self._energies)) / (degrees * (1.0 - 2.0 / (9.0 * degrees)) ** 3)
        count = len(self._energies)
        found = min(found, MOST_NOISE**2 * stated)
        self._variance = max(stated, (PRIOR_READINGS * stated + count * found) / (PRIOR_READINGS + count))

    def _add_sum(self, change: Float) -> None:
        if self._row + 2 > len(self._sums):
            # Windows begin in the last 2 LONGEST rows or end in the first LONGEST.
            kept = np.r_[: LONGEST + 1, self._row - 2 * LONGEST : self._row + 1]
            self._sums[: len(kept)] = self._sums[kept]
            self._row = len(kept) - 1
        self._sums[self._row + 1] = self._sums[self._row] + change
        self._row += 1
        self._count += 1

    def _test(self, feet: StandingFeet) -> None:
        """Compare all windows that end at the last reading with earlier ones."""
        sums, row, count = self._sums, self._row, self._count
        windows = 2 ** np.arange(int(math.log2(min(count - 1, LONGEST))) + 1)
        pairs = windows[2 * windows < count]
        to_end, begin = sums[row], sums[row - windows]
        paired = sums[row - pairs]
        means = (to_end - begin) / windows[:, None]
        before = [
            begin / (count - windows)[:, None],
            sums[pairs] / pairs[:, None],
            (paired - sums[row - 2 * pairs]) / pairs[:, None],
        ]
        of = np.concatenate([windows, pairs, pairs])
        against = np.concatenate([count - windows, pairs, pairs])
        changes = np.concatenate([means, means[: len(pairs)], means[: len(pairs)]]) - np.concatenate(before)
        motions = changes @ feet.motion.T
        shares = 1 / of + 1 / against
        chi2 = np.sum((changes @ feet.whitened.T) ** 2, axis=1) / (self._variance * shares)
        shifts, turns = np.linalg.norm(motions[:, :3], axis=1), np.linalg.norm(motions[:, 3:], axis=1)
        limits = self._robot.pause_limits
        over = (shifts > limits.camera_translation_limit) | (turns > limits.camera_rotation_limit)
        found = np.flatnonzero((chi2 > _threshold(count)) & over)
        self._latest = feet.motion @ (sums[row] - sums[row - 1])
        # Feet that moved relative to each other are not noise, and give no valid motion of the body.
        noise = self._variance if len(self._energies) >= LEARNED else self._robot.noise.encoder_noise**2
        apart = np.sum((changes @ feet.residual.T) ** 2, axis=1) / (max(noise, LEAST_NOISE**2) * shares)
        worst: int | None = None
        if not self._motion and found.size:
            worst = int(found[np.argmax(chi2[found])])
            self._motion = (
                f"the camera moved by {1e3 * shifts[worst]:.2f} mm and {math.degrees(turns[worst]):.3f} degrees "
                f"during the scan; {1e3 * limits.camera_translation_limit:g} mm and "
                f"{math.degrees(limits.camera_rotation_limit):.3g} degrees are allowed: scan again"
            )
        elif not self._motion and np.any(apart > most_apart(len(feet.residual))):
            worst = int(np.argmax(apart))
            self._motion = (
                "standing feet moved relative to each other during the scan, or the joints are far noisier than "
                f"encoder_noise of robot.toml ({math.degrees(self._robot.noise.encoder_noise):.3f} degrees): scan again"
            )
        if worst is not None:
            # Earliest start of the motion: the start of the preceding window, or the end of the pause's first window if
            # the motion was detected by comparison with that.
            window = int(of[worst])
            is_first = len(windows) <= worst < len(windows) + len(pairs)
            began = self._head_times[window - 1] if is_first else self._times[-min(2 * window, len(self._times))]
            self._still_until = min(self._still_until, began)
        if not self._motion:
            self._still_until = max(self._still_until, min(islice(reversed(self._times), self._needed())))

    def _recent(self) -> int:
        """Number of readings in the last `PULSE_S`, at least one and at most all but one."""
        since = self._times[-1] - PULSE_S
        recent = next((age for age, time in enumerate(reversed(self._times)) if time <= since), len(self._times))
        return max(1, min(recent, self._count - 1))

    def _needed(self) -> int:
        """Number of readings after the start of a motion within which the motion is detected.

        If the noise is too large for that, the number in the last `PULSE_S`.
        """
        recent = self._recent()
        windows = np.arange(1, min(recent, MOST_NEEDED) + 1)
        enough = np.flatnonzero(self._power(windows, WITH_HOLD if recent >= OFTEN else WITHOUT_HOLD) >= POWER)
        return int(windows[enough[0]]) if enough.size else recent

    def _power(self, windows: npt.ArrayLike, sizes: tuple[float, float], scales: npt.ArrayLike = 1.0) -> Float:
        """Probability (n,) of detecting a step in a random direction with windows that end now.

        The step is a translation or rotation of `scales` times `sizes`; the lower of the two probabilities is returned.
        """
        assert self._feet is not None
        windows = np.asarray(windows, dtype=np.float64)
        variances = self._variance * (1 / windows + 1 / np.maximum(self._count - windows, 1.0))
        threshold = _threshold(self._count)
        chances = []
        for size, units in zip(sizes, self._feet.units, strict=True):
            x = np.multiply.outer(np.square(np.multiply(size, scales)) / variances, units)
            # Normal approximation of noncentral chi^2, with the logistic function for the normal distribution; accurate
            # to 1 % near POWER.
            sigmas = (x + 6.0 - threshold) / np.sqrt(12.0 + 4.0 * x)
            chances.append(np.mean(1.0 / (1.0 + np.exp(-1.702 * sigmas)), axis=-1))
        return np.minimum(*chances)


def camera_motion(
    robot: RobotModel, begin: Stance, end: Stance, *, transform_camera_to_base: npt.ArrayLike | None = None
) -> CameraMotion:
    """Motion of the camera between two readings, computed by `Stillness` from these two alone.

    Args:
        robot: the model.
        begin: stance read before the scan.
        end: stance read after the scan.
        transform_camera_to_base: (4, 4) calibrated pose of the camera; None = the pose in the URDF.

    Raises:
        ArgumentError: the matrix is not a transform.
        StanceError: fewer than three feet carried the body at both readings, or these feet are on a line.
        UnknownName, JointPositionError: joints or supporting feet are not those of the robot, or a position is invalid.
    """
    return _of_two(robot, begin, end, transform_camera_to_base).between_first_and_last()


def check_camera_still(
    robot: RobotModel, begin: Stance, end: Stance, *, transform_camera_to_base: npt.ArrayLike | None = None
) -> CameraMotion:
    """Check that the camera stood still between two readings, and return the motion that `camera_motion` computes.

    Raises:
        CameraMoved: the camera moved, or standing feet moved relative to each other, or the joints are far noisier than
            robot.toml states.
        ArgumentError, StanceError, UnknownName, JointPositionError: as in `camera_motion`.
    """
    stillness = _of_two(robot, begin, end, transform_camera_to_base)
    if stillness.motion:
        raise CameraMoved(stillness.motion)
    return stillness.between_first_and_last()


def _of_two(robot: RobotModel, begin: Stance, end: Stance, camera: npt.ArrayLike | None) -> Stillness:
    stillness = Stillness(robot, begin, 0.0, transform_camera_to_base=camera)
    stillness.add(1.0, end)
    return stillness


def _threshold(count: int) -> float:
    """Limit of chi^2, with six degrees of freedom, above which a motion is reported after this many readings.

    Half of the allowed false alarms are allotted to the second reading, the other half to all later readings in
    proportion to 1 / ((n - 1)(n - 2)), which sums to less than one over a pause of any length. All tests at one reading
    have the same share.
    """
    from scipy.special import chdtri

    windows = int(math.log2(min(count - 1, LONGEST))) + 1
    tests = 1 if count == 2 else 3 * windows * (count - 1) * (count - 2)
    return float(chdtri(6, 0.5 * FALSE_ALARMS / tests))


def most_apart(degrees: int) -> float:
    """Largest chi^2 of the residual attributed to noise.

    This is the mean of chi^2 at three times the assumed sigma, plus 18. Noise of the assumed sigma does not reach it.
    """
    return 9.0 * degrees + 18.0


def _checked_time(time: float) -> float:
    if not math.isfinite(time):
        raise ArgumentError(f"time is {time}; it must be finite")
    return float(time)


def _directions() -> Float:
    """Unit vectors spread evenly over a hemisphere (a Fibonacci lattice)."""
    count = 64
    z = (np.arange(count) + 0.5) / count
    turns = np.arange(count) * math.pi * (3.0 - math.sqrt(5.0))
    radius = np.sqrt(1.0 - z**2)
    return np.stack([radius * np.cos(turns), radius * np.sin(turns), z], axis=1)


DIRECTIONS = _directions()
