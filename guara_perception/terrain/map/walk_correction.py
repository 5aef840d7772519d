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

from guara_perception.arrays import Float
from guara_perception.exceptions import InvalidInput
from guara_perception.fields import Fields
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.map.fuse_heights import OdometryDrift
from guara_perception.terrain.map.odom_cells import OdomCells
from guara_perception.terrain.map.registration import register
from guara_perception.terrain.map.sideways import kept_growth

SIDEWAYS = [0, 1, 5]
# Priors of height and tilt, which registration estimates too but does not correct: the soles hold the height.
HEIGHT_SIGMA_M = 0.003
TILT_SIGMA = 0.001
# No motion is surer than this: it keeps the covariances positive.
LEAST_SIGMA_M, LEAST_SIGMA_RAD = 1e-4, 3e-5


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
