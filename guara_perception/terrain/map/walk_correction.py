"""Holds the walk to the map sideways: registration of each scan corrects the drift of leg odometry.

A Kalman filter over x, y and heading. The pose that odometry gives for a pause is off by its drift, which goes on to
the next pauses, and by that pause's own noise, which does not. With P the covariance of the drift and W that of the
noise, the overlap of scan and map, which sees both, reduces P + W to C and moves the pause by m; of that

    K m,  K = P (P + W)^-1        is drift, of which P - K (P + W - C) K' is left.

Without W all of m would be carried on: the noise of a pause, larger than the drift until the next, would move all that
follow. Nothing is shifted silently: correction and sigmas are in the map's record.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from guara_perception.arrays import Float, Index
from guara_perception.exceptions import FileFormatError, InvalidInput
from guara_perception.fields import Fields
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.map.fuse_heights import OdometryDrift
from guara_perception.terrain.map.odom_cells import OdomCells
from guara_perception.terrain.map.registration import register
from kinematics.arrays import read_only

SIDEWAYS = [0, 1, 5]
# Priors of height and tilt, which registration estimates too but does not correct: the soles hold the height.
HEIGHT_SIGMA_M = 0.003
TILT_SIGMA = 0.001
# No motion is surer than this: it keeps the covariances positive.
LEAST_SIGMA_M, LEAST_SIGMA_RAD = 1e-4, 3e-5
# Pauses that are kept; what was seen before the first of them is treated as seen then, and has long been stale.
MOST_PAUSES = 256


@dataclass(frozen=True, slots=True, eq=False)
class WalkCorrection:
    """State of the filter.

    Attributes:
        transform: (4, 4) to be multiplied from the left to transforms of odometry; a turn about z and a shift in x, y.
        covariance: (3, 3) covariance of the drift in x, y and heading that is left after this correction.
        here: (4, 4) as `transform`, for the last pause alone: its own noise is corrected too.
        left: (3, 3) covariance of x, y and heading of the last pause against the map.
        own: (3, 3) covariance of the last pause's own noise.
        last: transform_footprint_to_odom of the last pause as odometry gave it, None before the first.
        growth: (3, 3) covariance of the last motion, as far as the overlap did not remove it.
        shift, turn: variances of all motions, summed since the start [m^2, rad^2].
        refused: why the last overlap was not used, None where it was.
    """

    transform: Float
    covariance: Float
    here: Float = field(default_factory=lambda: np.eye(4))
    left: Float = field(default_factory=lambda: np.zeros((3, 3)))
    own: Float = field(default_factory=lambda: np.zeros((3, 3)))
    last: Float | None = None
    growth: Float = field(default_factory=lambda: np.zeros((3, 3)))
    shift: float = 0.0
    turn: float = 0.0
    refused: str | None = None

    @staticmethod
    def none() -> WalkCorrection:
        """Before the first pause."""
        return WalkCorrection(np.eye(4), np.zeros((3, 3)))

    def check_kind(self, scans: int, *, is_registered: bool, step: int) -> None:
        """Refuse a pause of another kind than the `scans` before: the drift of the motion between would not be known.

        Raises:
            InvalidInput: the covariance of the motion is given now and was not before, or the other way round.
        """
        if not scans or is_registered == (self.last is not None):
            return
        now, before = ("given", "not given") if is_registered else ("not given", "given")
        raise InvalidInput(
            f"covariance_since_last is {now} at step {step} and was {before} at the pauses before: give it at every "
            "pause of a walk or at none"
        )

    def drift(self, last: OdometryDrift, rise: float, covariance: Float | None) -> OdometryDrift:
        """How far the walk may have drifted by now, never less than before.

        Args:
            last: drift at the pause before.
            rise: variance of z [m^2].
            covariance: (6, 6) since the start, of a walk that is taken as odometry gives it; None = what is left here.
        """
        shift, turn = self.shift, self.turn
        if covariance is not None:
            shift, turn = float(np.diag(covariance)[:2].max()), float(covariance[5, 5])
        return OdometryDrift(rise, max(last.shift, shift), max(last.turn, turn))

    def report(self) -> dict[str, Any]:
        """Its fields of the map's record."""
        return {
            "sideways_correction": (*self.here[:2, 3].tolist(), float(np.arctan2(*self.here[1::-1, 0]))),
            "sideways_correction_sigma": tuple(np.sqrt(np.diag(self.left)).tolist()),
            "registration_refused": self.refused,
        }

    def to_fields(self) -> dict[str, Any]:
        """All of it as plain JSON values."""
        fields = {name: getattr(self, name) for name in self.__slots__}
        return {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in fields.items()}

    @staticmethod
    def of_fields(fields: Fields) -> WalkCorrection:
        """What `to_fields` gave.

        Raises:
            FileFormatError: a value is missing or impossible.
        """
        return WalkCorrection(
            transform=fields.array("transform", (4, 4)),
            covariance=fields.array("covariance", (3, 3)),
            here=fields.array("here", (4, 4)),
            left=fields.array("left", (3, 3)),
            own=fields.array("own", (3, 3)),
            last=fields.array("last", (4, 4)) if fields.has("last") else None,
            growth=fields.array("growth", (3, 3)),
            shift=fields.number("shift", 0.0),
            turn=fields.number("turn", 0.0),
            refused=fields.text("refused") if fields.has("refused") else None,
        )

    def after(
        self, cells: OdomCells, terrain: TerrainGrid, odometry: Float, rise: float, since_last: Float, own: Float
    ) -> WalkCorrection:
        """The state one pause later.

        Args:
            cells: the memory of the map.
            terrain: the scan of the pause.
            odometry: (4, 4) transform_footprint_to_odom as odometry gives it.
            rise: correction of its z [m].
            since_last: (6, 6) covariance of the motion since the last pause, in the last footprint.
            own: (6, 6) covariance of the pause's own noise, along the axes of odom.
        """
        if self.last is None:
            # The motion to the first pause moved nothing in the map, which begins at the pose of that pause.
            return replace(self, last=odometry.copy())
        here, before = self.transform @ odometry, self.transform @ self.last
        rotation = np.kron(np.eye(2), before[:3, :3])
        growth = rotation @ since_last @ rotation.T
        carried = np.eye(3)
        carried[:2, 2] = before[1, 3] - here[1, 3], here[0, 3] - before[0, 3]
        added = growth[np.ix_(SIDEWAYS, SIDEWAYS)] + np.diag([LEAST_SIGMA_M**2] * 2 + [LEAST_SIGMA_RAD**2])
        turned = self.transform[:3, :3]
        noise = turned @ own[np.ix_(SIDEWAYS, SIDEWAYS)] @ turned.T
        drift = carried @ self.covariance @ carried.T + _without(added, carried @ self.own @ carried.T + noise)
        sideways = drift + noise
        prior = np.diag([0.0, 0.0, growth[2, 2] + HEIGHT_SIGMA_M**2, TILT_SIGMA**2, TILT_SIGMA**2, 0.0])
        terrain.record.check("pose_covariance")
        tilt = terrain.record.pose_covariance
        if tilt is not None:
            prior[3:5, 3:5] += tilt[3:5, 3:5]
        prior[np.ix_(SIDEWAYS, SIDEWAYS)] = sideways
        here[2, 3] += rise
        found = register(cells, terrain, here, prior)
        left = found.covariance[np.ix_(SIDEWAYS, SIDEWAYS)]
        kept = kept_growth(added, sideways, left)
        share = np.linalg.solve(sideways, drift).T
        return WalkCorrection(
            transform=_moved(share @ found.motion[SIDEWAYS], here) @ self.transform,
            covariance=drift - share @ (sideways - left) @ share.T,
            here=_moved(found.motion[SIDEWAYS], here) @ self.transform,
            left=left,
            own=noise,
            last=odometry.copy(),
            growth=kept,
            shift=self.shift + float(np.linalg.eigvalsh(kept[:2, :2])[-1]),
            turn=self.turn + float(kept[2, 2]),
            refused=found.refused,
        )


def _without(growth: Float, noise: Float) -> Float:
    """Covariance (3, 3) of a motion's drift: without the noise of both its ends, but with the least sigmas."""
    least = np.diag([LEAST_SIGMA_M, LEAST_SIGMA_M, LEAST_SIGMA_RAD])
    inverse = np.linalg.inv(least)
    variances, directions = np.linalg.eigh(inverse @ (growth - noise) @ inverse)
    root = least @ directions
    return np.asarray(root * np.maximum(variances, 1.0) @ root.T)


def _moved(motion: Float, about: Float) -> Float:
    """Transform (4, 4) of a shift in x and y and a turn (3,) about the vertical through a transform's position."""
    cosine, sine = np.cos(motion[2]), np.sin(motion[2])
    transform = np.eye(4)
    transform[:2, :2] = [[cosine, -sine], [sine, cosine]]
    transform[:2, 3] = about[:2, 3] - transform[:2, :2] @ about[:2, 3] + motion[:2]
    return transform


@dataclass(frozen=True, slots=True, eq=False)
class SidewaysDrift:
    """Covariances of the motions of a walk, summed pause by pause.

    Each is that of (x, y, heading) about the origin of `odom`, so that every motion turns a cell about the position of
    the robot at that time: the difference of two sums is the covariance of all motions between.

    Attributes:
        pauses: (k,) ascending.
        total: (k, 3, 3) sums from the start to each [m, rad].
    """

    pauses: Index
    total: Float

    def __post_init__(self) -> None:
        object.__setattr__(self, "pauses", read_only(self.pauses))
        object.__setattr__(self, "total", read_only(self.total))

    @staticmethod
    def none() -> SidewaysDrift:
        """Before the first pause."""
        return SidewaysDrift(np.empty(0, np.int64), np.empty((0, 3, 3)))

    def after(self, pause: int, growth: Float, position: Float) -> SidewaysDrift:
        """One pause later.

        Args:
            pause: number of the pause.
            growth: (3, 3) covariance that the motion left, about the robot and along the axes of odom.
            position: (2,) position of the robot in odom [m].
        """
        about_origin = np.array([[1.0, 0.0, position[1]], [0.0, 1.0, -position[0]], [0.0, 0.0, 1.0]])
        added = about_origin @ growth @ about_origin.T
        last = self.total[-1] if len(self.total) else np.zeros((3, 3))
        pauses, total = np.append(self.pauses, pause), np.concatenate((self.total, (last + added)[None]))
        return SidewaysDrift(pauses[-MOST_PAUSES:], total[-MOST_PAUSES:])

    def variances(self, seen: Index, x: Float, y: Float, transform_footprint_to_odom: Float) -> Float:
        """Variances (2, n) of the positions of cells along x and y of the footprint [m^2].

        Args:
            seen: (n,) pauses at which they were last seen.
            x, y: (n,) positions of the cells in odom [m].
            transform_footprint_to_odom: (4, 4).
        """
        if not len(self.pauses):
            return np.zeros((2, len(seen)))
        entry = np.clip(np.searchsorted(self.pauses, seen, side="right") - 1, 0, None)
        axes = transform_footprint_to_odom[:2, :2]
        # Of each pause first, so that a cell takes three products along each axis: J = [[1, 0, -y], [0, 1, x]].
        since = self.total[-1] - self.total
        result = np.empty((2, len(seen)))
        for axis, (ax, ay) in enumerate(axes.T.tolist()):
            shift = ax * ax * since[:, 0, 0] + 2 * ax * ay * since[:, 0, 1] + ay * ay * since[:, 1, 1]
            both = 2 * (ax * since[:, 0, 2] + ay * since[:, 1, 2])
            lever = ay * x - ax * y
            result[axis] = shift[entry] + lever * (both[entry] + lever * since[:, 2, 2][entry])
        return np.maximum(result, 0.0)

    def to_fields(self) -> dict[str, Any]:
        """All of it as plain JSON values."""
        return {"pauses": self.pauses.tolist(), "total": self.total.tolist()}

    @staticmethod
    def of_fields(fields: Fields) -> SidewaysDrift:
        """What `to_fields` gave.

        Raises:
            FileFormatError: a value is missing or impossible, or a drift shrinks.
        """
        count = len(fields.sequence("pauses"))
        pauses = fields.array("pauses", (count,)) if count else np.empty(0)
        total = fields.array("total", (count, 3, 3)) if count else np.empty((0, 3, 3))
        # Drift that shrinks would take the margins of the map away.
        if (np.diff(pauses) <= 0).any() or (np.diff(total, axis=0).diagonal(axis1=1, axis2=2) < 0).any():
            raise FileFormatError(
                f"{fields.path_to('total')} or pauses shrink from one pause to the next, the file is damaged"
            )
        return SidewaysDrift(pauses.astype(np.int64), total)


def kept_growth(added: Float, prior: Float, left: Float) -> Float:
    """A motion's covariance `added` after an overlap has shrunk `prior` to `left`; (3, 3) each.

    It shrinks along each direction by the same share as the prior: for one unknown to `added * left / prior`, as with
    any error that a Kalman filter corrects.
    """
    root = np.linalg.cholesky(prior)
    inverse = np.linalg.inv(root)
    share, directions = np.linalg.eigh(inverse @ left @ inverse.T)
    half = directions * np.sqrt(np.clip(share, 0.0, 1.0)) @ directions.T
    kept = root @ half @ inverse
    return np.asarray(kept @ added @ kept.T)
