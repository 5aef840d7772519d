"""How far cells of the map may have drifted sideways, along and across the robot, since they were last seen."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from guara_perception.arrays import Float, Index
from guara_perception.exceptions import FileFormatError
from guara_perception.fields import Fields
from kinematics.arrays import read_only

# Pauses that are kept; what was seen before the first of them is treated as seen then, and has long been stale.
MOST_PAUSES = 256


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
