"""Test of the corrections of a walk against the accumulated drift of odometry, to detect moving ground.

The gate of a registration compares it with the error of odometry in one motion. Ground that moves by less at each pause
passes this gate and drags the map along. Over several pauses the motions of the ground add up, but the errors of
odometry grow only with the square root of the number of pauses. So, for each of the last EARLIER_PAUSES pauses j, two
sums since j are compared with the drift of odometry since j:

    d = T_j^-1 T                        corrections of the map, where T is the correction of the drift
    d = sum of the motions from scan to scan minus those of odometry

The second sum detects slowly moving ground first: if few heights show the motion, the corrections follow only a small
part of it. Let w be the displacement since j, and s the sigma of odometry along w, relative to its length. This error
has the same sign at all pauses: odometry cannot detect a slide of all feet together, because it does not change the
distances between them. Let P_j be the covariance at j, of the drift for the first sum and of the noise for the second,
F the transition from footprint j to the present one (`transition_between`), and N the covariance of the heights and of
the present noise, for the second sum only. Then the covariance of d is

    S = F P_j F' + drift of odometry since + N + s^2 w w'

plus the slip that is accepted where texture shows it (`shown_slip`).

If d' S^-1 d exceeds a bound for any j, either the ground moved or odometry is worse than it states. It cannot be
decided which, so all corrections since the earliest such j are discarded. Earlier corrections are kept: had the ground
moved before, sums since earlier pauses would exceed the bound as well. If only the second sum exceeds the bound, and
the corrections of a walk with texture agree better with odometry than with the scans, only the heights are in doubt,
and the corrections are kept. In both cases, heights do not correct the walk during the next EARLIER_PAUSES pauses.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial

import numpy as np

from guara_perception.arrays import Float
from guara_perception.fields import Fields
from kinematics.arrays import FrozenArrays

# Number of earlier pauses that are compared, and number of pauses without registration after a contradiction. After so
# many pauses, the hind feet reach ground that was first seen at the oldest of them.
EARLIER_PAUSES = 24
# Bound of a sum [sigmas]. If a walk over still ground exceeds it, the corrections are lost and the walk continues with
# odometry; with 2 sigmas this happened in one of six walks.
MOST_SIGMAS = 3.0
# Sigmas of slip along and across the displacement, relative to its length, that are accepted if texture over the whole
# view shows the slip; and distance between the feet, which converts slip to yaw. In a simulation with physics, robots
# with position servos without feed-forward slip by 4 to 13 % along the path and by less than 1 % across it. The
# small sigma across keeps the correction from following ground that fills the view and moves sideways.
SHOWN_SLIP_ALONG, SHOWN_SLIP_ASIDE, LEVER_M = 0.06, 0.02, 0.3


@dataclass(frozen=True, slots=True, eq=False)
class Contradiction:
    """Corrections that the accumulated drift of odometry contradicts.

    Attributes:
        transform: (4, 4) correction before these corrections; None if texture confirms them and only heights are in
            doubt.
        covariance: (3, 3) covariance of the drift without these corrections.
        moved_by: (2, 3) x, y, yaw by which the corrections moved the robot, and by which scans contradict odometry
            [m, m, rad].
        reason: text for the record of the map.
    """

    transform: Float | None
    covariance: Float
    moved_by: Float
    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class OdometrySum(FrozenArrays):
    """Corrections, motions of scans and drift of odometry since each of k earlier pauses, newest last.

    Attributes:
        transforms: (k, 4, 4) corrections of the drift at the pauses.
        positions: (k, 2) positions of the robot from odometry at the pauses [m].
        covariances: (k, 3, 3) covariances of the drift at the pause and since then, about the current position of the
            robot.
        seen: (k, 3) x, y, yaw by which the motion since the pause, as shown by scans, exceeds that of odometry, about
            the current position of the robot.
        seen_covariances: (k, 3, 3) covariances of `seen`, without the noise of the current pause.
        shown: (k,) length of that part of the path since the pause which texture over the whole view confirmed [m].
    """

    transforms: Float = field(default_factory=partial(np.empty, (0, 4, 4)))
    positions: Float = field(default_factory=partial(np.empty, (0, 2)))
    covariances: Float = field(default_factory=partial(np.empty, (0, 3, 3)))
    seen: Float = field(default_factory=partial(np.empty, (0, 3)))
    seen_covariances: Float = field(default_factory=partial(np.empty, (0, 3, 3)))
    shown: Float = field(default_factory=partial(np.empty, 0))

    def started(self, transform: Float, odometry: Float, covariance: Float, noise: Float) -> OdometrySum:
        """Add a pause.

        Args:
            transform: (4, 4) correction of the drift at the pause.
            odometry: (4, 4) transform_footprint_to_odom from odometry.
            covariance: (3, 3) covariance of the drift at the pause.
            noise: (3, 3) covariance of the noise of this pause alone.
        """
        added = (transform, odometry[:2, 3], covariance, np.zeros(3), noise, np.zeros(()))
        before = [getattr(self, name) for name in OdometrySum.__slots__]
        return OdometrySum(
            *(np.concatenate((old, new[None]))[-EARLIER_PAUSES:] for old, new in zip(before, added, strict=True))
        )

    def grown(
        self, transition: Float, drift: Float, seen: Float, seen_covariance: Float, shown: float = 0.0
    ) -> OdometrySum:
        """Add one motion to each sum.

        Args:
            transition: (3, 3) result of `transition_between`.
            drift: (3, 3) covariance of the drift of odometry in this motion.
            seen: (3,) x, y, yaw by which the motion shown by scans exceeds that of odometry.
            seen_covariance: (3, 3) covariance of `seen` due to the heights alone.
            shown: length of the motion if texture over the whole view confirms it, otherwise 0 [m].
        """
        return OdometrySum(
            self.transforms,
            self.positions,
            transition @ self.covariances @ transition.T + drift,
            self.seen @ transition.T + seen,
            transition @ self.seen_covariances @ transition.T + drift + seen_covariance,
            self.shown + shown,
        )

    def contradiction(
        self, transform: Float, odometry: Float, noise: Float, slip_share: float, *, textured: bool = False
    ) -> Contradiction | None:
        """Corrections since the earliest pause for which a sum contradicts odometry; None if no sum does.

        Args:
            transform: (4, 4) current correction of the drift.
            odometry: (4, 4) current transform_footprint_to_odom from odometry.
            noise: (3, 3) covariance of the noise of the current pause alone.
            slip_share: sigma of odometry along the displacement, relative to its length.
            textured: True if there is texture of earlier pauses.
        """
        if not len(self.transforms):
            return None
        corrected, slip = self._corrected(transform, odometry), self._slip(odometry, slip_share)
        covariances = self.covariances + slip
        sums = np.stack((corrected, self.seen))
        seen_squares = _squares(self.seen, self.seen_covariances + noise + slip)
        squares = np.stack((_squares(corrected, covariances), seen_squares))
        over = np.flatnonzero((squares > MOST_SIGMAS**2).any(axis=0))
        if not over.size:
            return None
        first = int(over[0])
        kind = int(np.argmax(squares[:, first]))
        x, y, yaw = sums[kind, first].tolist()
        reason = (
            f"{('registration shifted the walk', 'scans and odometry differ')[kind]} by "
            f"{1e3 * np.hypot(x, y):.0f} mm and {1e3 * yaw:+.0f} mrad in "
            f"{len(self.transforms) - first} pauses, {np.sqrt(squares[kind, first]):.1f} sigma of the error "
            "accumulated by odometry: the ground in view may be moving, so it is not used"
        )
        moved_by = np.stack((corrected[first], self.seen[first]))
        to_scans = _squares(self.seen - corrected, covariances)[first]
        is_confirmed = textured and bool(squares[0].max() <= MOST_SIGMAS**2 and squares[0, first] < to_scans)
        return Contradiction(None if is_confirmed else self.transforms[first], covariances[first], moved_by, reason)

    def suspicion(self, odometry: Float, noise: Float, slip_share: float) -> float:
        """Largest contradiction between the motions of scans and odometry since any of the k pauses [sigmas].

        Args:
            odometry, noise, slip_share: as in `contradiction`.
        """
        covariances = self.seen_covariances + noise + self._slip(odometry, slip_share)
        return float(np.sqrt(_squares(self.seen, covariances).max(initial=0.0)))

    def _corrected(self, transform: Float, odometry: Float) -> Float:
        """Corrections (k, 3) since each pause, about the current position of the robot."""
        position = odometry[:2, 3]
        since = np.linalg.inv(self.transforms) @ transform
        aside = since[:, :2, :2] @ position + since[:, :2, 3] - position
        return np.column_stack((aside, np.arctan2(since[:, 1, 0], since[:, 0, 0])))

    def _slip(self, odometry: Float, slip_share: float) -> Float:
        """Covariances (k, 3, 3) of slip since each pause, including the slip accepted where texture shows it."""
        way = odometry[:2, 3] - self.positions
        slip = np.zeros_like(self.covariances)
        slip[:, :2, :2] = slip_share**2 * way[:, :, None] * way[:, None, :]
        length = np.maximum(np.linalg.norm(way, axis=1), 1e-9)
        shown = way * (np.minimum(self.shown, length) / length)[:, None]
        return slip + np.array([shown_slip(each) for each in shown]).reshape(-1, 3, 3)

    @staticmethod
    def of_fields(fields: Fields) -> OdometrySum:
        """Read the sums from a file.

        Raises:
            FileFormatError: a value is missing or not allowed.
        """
        start, count = OdometrySum(), len(fields.sequence("positions"))
        # Files of earlier versions lack some of these values; their sums start without pauses.
        if not count or not fields.has("shown"):
            return start
        shapes = {name: (count, *getattr(start, name).shape[1:]) for name in OdometrySum.__slots__}
        return OdometrySum(**{name: fields.array(name, shape) for name, shape in shapes.items()})


def _squares(sums: Float, covariances: Float) -> Float:
    """Squared Mahalanobis norms (k,) of sums (k, 3) with covariances (k, 3, 3)."""
    return np.asarray(np.vecdot(sums, np.linalg.solve(covariances, sums[:, :, None])[:, :, 0]))


def shown_slip(way: Float) -> Float:
    """Accepted covariance (3, 3) of slip over a displacement (2,) [m] if texture shows the slip."""
    along, aside = SHOWN_SLIP_ALONG * way, SHOWN_SLIP_ASIDE * np.array([-way[1], way[0]])
    slip = np.zeros((3, 3))
    slip[:2, :2] = np.outer(along, along) + np.outer(aside, aside)
    slip[2, 2] = along @ along / LEVER_M**2
    return slip


def transition_between(before: Float, here: Float) -> Float:
    """Matrix (3, 3) that converts an error (x, y, yaw) about one footprint to the same error about the next footprint.

    Args:
        before, here: (4, 4) transforms of the two footprints to odom.
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
