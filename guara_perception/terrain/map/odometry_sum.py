"""Comparison of the corrections of a walk with the sum of odometry's own drift.

A registration is compared with odometry's error of one motion. Ground that moves by less at each pause passes, pause by
pause, and takes the map along. Over several pauses the ground's motions add up, and odometry's errors grow with the
square root only. For the pauses since each earlier pause j, with T the correction of the drift,

    d = T_j^-1 T  (x, y, yaw about the robot),    S = F P_j F' + drift of odometry since + s^2 w w',

where P_j is the filter's covariance at j, and s the share of the way w by which odometry may err along the way, always
with the same sign: feet that all slide back keep their distances. If d' S^-1 d exceeds a bound for any j, either the
ground moved or odometry is worse than it says. It cannot be told which, so nothing of d is kept.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial

import numpy as np

from guara_perception.arrays import Float
from guara_perception.fields import Fields
from kinematics.arrays import FrozenArrays

# Pauses that are compared: in this number of them the hind feet reach what came into view first.
EARLIER_PAUSES = 24
# A still walk that is refused loses its corrections and keeps odometry; with 2 sigma one in six was.
MOST_SIGMAS = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class Contradiction:
    """Corrections that odometry's sum contradicts.

    Attributes:
        transform: (4, 4) correction before them.
        covariance: (3, 3) covariance of the drift without them.
        taken_back: (3,) x, y, yaw that they moved the robot by [m, m, rad].
        reason: sentence that says so.
    """

    transform: Float
    covariance: Float
    taken_back: Float
    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class OdometrySum(FrozenArrays):
    """Corrections at earlier pauses, the newest last, and odometry's drift since.

    Attributes:
        transforms: (k, 4, 4) corrections of the drift.
        positions: (k, 2) of the robot by odometry [m].
        covariances: (k, 3, 3) of the drift at the pause and since, about the present robot.
    """

    transforms: Float = field(default_factory=partial(np.empty, (0, 4, 4)))
    positions: Float = field(default_factory=partial(np.empty, (0, 2)))
    covariances: Float = field(default_factory=partial(np.empty, (0, 3, 3)))

    def started(self, transform: Float, odometry: Float, covariance: Float) -> OdometrySum:
        """Add a pause.

        Args:
            transform: (4, 4) correction of the drift there.
            odometry: (4, 4) transform_footprint_to_odom by odometry.
            covariance: (3, 3) covariance of the drift there.
        """
        return OdometrySum(
            np.concatenate((self.transforms, transform[None]))[-EARLIER_PAUSES:],
            np.concatenate((self.positions, odometry[None, :2, 3]))[-EARLIER_PAUSES:],
            np.concatenate((self.covariances, covariance[None]))[-EARLIER_PAUSES:],
        )

    def grown(self, transition: Float, drift: Float) -> OdometrySum:
        """Add one motion's drift (3, 3) to each sum; `transition` (3, 3) is that of `transition_between`."""
        return OdometrySum(self.transforms, self.positions, transition @ self.covariances @ transition.T + drift)

    def contradiction(self, transform: Float, odometry: Float, slip_share: float) -> Contradiction | None:
        """Corrections since the first pause from which their sum contradicts odometry's; None if none does.

        Args:
            transform: (4, 4) present correction of the drift.
            odometry: (4, 4) present transform_footprint_to_odom by odometry.
            slip_share: sigma of odometry in the direction of the way, as a share of it.
        """
        if not len(self.transforms):
            return None
        position = odometry[:2, 3]
        since = np.linalg.inv(self.transforms) @ transform
        aside = since[:, :2, :2] @ position + since[:, :2, 3] - position
        moved_by = np.column_stack((aside, np.arctan2(since[:, 1, 0], since[:, 0, 0])))
        way = position - self.positions
        covariances = self.covariances.copy()
        covariances[:, :2, :2] += slip_share**2 * way[:, :, None] * way[:, None, :]
        squares = np.einsum("ki,ki->k", moved_by, np.linalg.solve(covariances, moved_by[:, :, None])[:, :, 0])
        over = np.flatnonzero(squares > MOST_SIGMAS**2)
        if not over.size:
            return None
        first = int(over[0])
        x, y, yaw = moved_by[first].tolist()
        reason = (
            f"registration has moved the walk by {1e3 * np.hypot(x, y):.0f} mm and {1e3 * yaw:+.0f} mrad in "
            f"{len(self.transforms) - first} pauses, {np.sqrt(squares[first]):.1f} sigma of what odometry adds up to: "
            "ground that is seen may move, so it is not used"
        )
        return Contradiction(self.transforms[first], covariances[first], moved_by[first], reason)

    @staticmethod
    def of_fields(fields: Fields) -> OdometrySum:
        """Read the sums from a file.

        Raises:
            FileFormatError: a value is missing or impossible.
        """
        count = len(fields.sequence("positions"))
        shapes = {"transforms": (count, 4, 4), "positions": (count, 2), "covariances": (count, 3, 3)}
        return (
            OdometrySum(**{name: fields.array(name, shape) for name, shape in shapes.items()})
            if count
            else OdometrySum()
        )


def transition_between(before: Float, here: Float) -> Float:
    """Matrix (3, 3) that takes an error (x, y, yaw) about one footprint to the same error about the next.

    Args:
        before, here: (4, 4) transforms of both footprints to odom.
    """
    transition = np.eye(3)
    transition[:2, 2] = before[1, 3] - here[1, 3], here[0, 3] - before[0, 3]
    return transition


def moved(motion: Float, about: Float) -> Float:
    """Transform (4, 4) of a planar motion (x, y, yaw) about the vertical through the origin of a transform."""
    cosine, sine = np.cos(motion[2]), np.sin(motion[2])
    transform = np.eye(4)
    transform[:2, :2] = [[cosine, -sine], [sine, cosine]]
    transform[:2, 3] = about[:2, 3] - transform[:2, :2] @ about[:2, 3] + motion[:2]
    return transform
