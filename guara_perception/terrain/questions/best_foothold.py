"""Best foothold near a nominal position, deterministic and stable from pause to pause."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from guara_perception.arrays import Float
from guara_perception.exceptions import InvalidInput
from guara_perception.settings import RobotLike
from guara_perception.terrain.layers.layered_grid import LayeredGrid, asked, look_up
from guara_perception.terrain.questions.foothold import (
    FootholdVerdict,
    FootholdVerdicts,
    check_foothold,
    enough_clearance,
)
from guara_perception.terrain.questions.normal import normal_at
from kinematics.arrays import FrozenArrays

# Factor of the value at the rim of the search, relative to the nominal position, which the gait prefers.
VALUE_AT_RIM = 0.5
# Factor of the value at zero clearance, relative to open ground.
VALUE_AT_EDGE = 0.5
# Relative gain in value required to replace the previous choice; prevents alternation between similar positions.
HYSTERESIS = 1 / 3


@dataclass(frozen=True, slots=True, eq=False)
class Foothold(FrozenArrays):
    """Position for a sole.

    Attributes:
        x, y: centre of the sole in base_footprint [m].
        z: height of the ground at this position [m].
        normal: (3,) unit normal of the ground.
        score: traversability of the position, greater than 0, at most 1.
        value: objective of the choice, greater than 0, at most 1: product of score, nearness and clearance factors.
        leg: leg of the query, or None.
    """

    x: float
    y: float
    z: float
    normal: Float
    score: float
    value: float
    leg: str | None

    def __repr__(self) -> str:
        """Short text with rounded numbers."""
        return (
            f"Foothold(x={self.x:.4f}, y={self.y:.4f}, z={self.z:.4f}, score={self.score:.2f}, "
            f"value={self.value:.2f}, leg={self.leg!r})"
        )

    @property
    def position(self) -> Float:
        """Position (3,) in base_footprint [m]."""
        return np.array([self.x, self.y, self.z])


def best_foothold(
    terrain: LayeredGrid,
    x: float,
    y: float,
    radius: float,
    leg: str | None = None,
    previous: Foothold | tuple[float, float] | None = None,
    robot: RobotLike | None = None,
    *,
    allow_stale: bool = False,
) -> Foothold | None:
    """Find the best foothold near a nominal position; None if there is none (`best_refused` gives the reasons).

    Candidates are the cell centres within the radius, the nominal position, and `previous` if it is within the radius.
    Of those that pass `check_foothold`, the result has the largest product of score, nearness and clearance factors,
    unless `previous` is kept. Ties are broken by distance from the nominal position, then by x, then by y, smallest
    first.

    Args:
        x, y: nominal position in base_footprint [m].
        radius: radius of the search [m].
        leg, robot: as in `check_foothold`.
        previous: previous choice, in base_footprint of this grid. It is kept while it is safe and within the radius,
            unless another position has a value that is at least a third higher.

    Raises:
        InvalidInput: x or y is not a finite number, the radius is not a number from 0 to 1 m, or `previous` is neither
            a Foothold nor a pair of finite numbers. Also as in `check_foothold`.
        kinematics.KinematicsError: no such leg, or the robot cannot be loaded or does not fit the stance.
    """
    terrain = asked(terrain, allow_stale)
    px, py = _candidates(terrain, x, y, radius)
    kept = _point(previous)
    if kept is not None and np.hypot(kept[0] - x, kept[1] - y) <= radius + 1e-9:
        px, py = np.append(px, kept[0]), np.append(py, kept[1])
    else:
        kept = None
    verdicts = check_foothold(terrain, px, py, leg, robot)
    assert isinstance(verdicts, FootholdVerdicts)
    distance = np.hypot(px - x, py - y)
    value = _values(terrain, verdicts, distance, float(radius))
    if not (value > 0).any():
        return None
    best = int(np.lexsort((py, px, np.round(distance, 9), -np.round(value, 9)))[0])
    if kept is not None and value[-1] > 0 and value[best] < value[-1] * (1 + HYSTERESIS):
        best = px.size - 1
    bx, by = float(px[best]), float(py[best])
    return Foothold(
        x=bx,
        y=by,
        z=float(terrain.height_at(bx, by)),
        normal=normal_at(terrain, bx, by),
        score=float(verdicts.score[best]),
        value=float(value[best]),
        leg=leg,
    )


@dataclass(frozen=True, slots=True)
class RefusedFoothold:
    """Position that is not a foothold, with the reasons.

    Attributes:
        x, y: centre of the sole in base_footprint [m].
        verdict: each failed test with value and limit.
        leg: leg of the query, or None.
    """

    x: float
    y: float
    verdict: FootholdVerdict
    leg: str | None

    def __repr__(self) -> str:
        """Short text with rounded numbers."""
        return f"RefusedFoothold(x={self.x:.4f}, y={self.y:.4f}, leg={self.leg!r}, {self.verdict})"


def best_refused(
    terrain: LayeredGrid,
    x: float,
    y: float,
    radius: float,
    leg: str | None = None,
    robot: RobotLike | None = None,
    *,
    allow_stale: bool = False,
) -> RefusedFoothold | None:
    """Find the candidate that came closest to being a foothold; None if no candidate is refused.

    Safe ground that is merely out of the leg's reach comes first, ordered by how far the joints would exceed their
    limits, smallest first. Other ground follows, ordered by clearance, largest first. Ties are broken as in
    `best_foothold`. Use the result in messages only: no foot may be placed at this position.

    Args:
        x, y, radius, leg, robot: as in `best_foothold`.

    Raises:
        InvalidInput, kinematics.KinematicsError: as in `best_foothold`.
    """
    terrain = asked(terrain, allow_stale)
    px, py = _candidates(terrain, x, y, radius)
    verdicts = check_foothold(terrain, px, py, leg, robot)
    ground = verdicts if leg is None else check_foothold(terrain, px, py)
    assert isinstance(verdicts, FootholdVerdicts) and isinstance(ground, FootholdVerdicts)
    beyond = np.where(ground.ok, np.nan_to_num(verdicts.beyond, nan=np.inf), 0.0)
    clearance = np.asarray(look_up(terrain, "clearance", px, py, np.float32(-np.inf)), dtype=np.float64)
    distance = np.round(np.hypot(px - x, py - y), 9)
    order = np.lexsort((py, px, distance, -clearance, beyond, ~ground.ok, verdicts.ok))
    best = int(order[0])
    if verdicts.ok[best]:
        return None
    return RefusedFoothold(float(px[best]), float(py[best]), verdicts[best], leg)


def checked_disc(x: float, y: float, radius: float) -> tuple[float, float, float]:
    """Reject a nominal position that is not finite, and a radius outside 0 ... 1 m.

    Raises:
        InvalidInput: as above, or a value is not a number.
    """
    if not all(isinstance(value, int | float | np.number) for value in (x, y, radius)):
        raise InvalidInput(f"x, y and radius are {x!r}, {y!r}, {radius!r}; three numbers are needed [m]")
    x, y, radius = float(x), float(y), float(radius)
    if not (np.isfinite(x) and np.isfinite(y)):
        raise InvalidInput(f"the nominal position is ({x}, {y}); it must be finite [m]")
    if not 0 <= radius <= 1:
        raise InvalidInput(f"radius is {radius}; it must be 0 ... 1 m")
    return x, y, radius


def _candidates(terrain: LayeredGrid, x: float, y: float, radius: float) -> tuple[Float, Float]:
    """Cell centres within the radius, followed by the nominal position."""
    x, y, radius = checked_disc(x, y, radius)
    cx, cy = terrain.geometry.centres()
    cx, cy = cx[np.abs(cx - x) <= radius], cy[np.abs(cy - y) <= radius]
    gx, gy = (a.ravel() for a in np.meshgrid(cx, cy))
    near = np.hypot(gx - x, gy - y) <= radius
    return np.append(gx[near], x), np.append(gy[near], y)


def _values(terrain: LayeredGrid, verdicts: FootholdVerdicts, distance: Float, radius: float) -> Float:
    enough = enough_clearance(terrain, terrain.record.required_limits)
    clearance = np.asarray(look_up(terrain, "clearance", verdicts.x, verdicts.y, np.float32(0)), dtype=np.float64)
    # The value increases with the clearance, up to twice the clearance that is always sufficient.
    openness = np.clip(clearance / (2 * enough), 0.0, 1.0)
    nearness = 1 - (1 - VALUE_AT_RIM) * (distance / radius) ** 2 if radius > 0 else np.ones(distance.shape)
    return np.asarray(verdicts.score * nearness * (VALUE_AT_EDGE + (1 - VALUE_AT_EDGE) * openness))


def _point(previous: Foothold | tuple[float, float] | None) -> tuple[float, float] | None:
    if previous is None:
        return None
    if isinstance(previous, Foothold):
        return previous.x, previous.y
    try:
        x, y = (float(v) for v in previous)
    except (TypeError, ValueError):
        raise InvalidInput(f"previous is {previous!r}; it must be a Foothold or a pair (x, y)") from None
    if not (np.isfinite(x) and np.isfinite(y)):
        raise InvalidInput(f"previous is ({x}, {y}); it must be finite [m]")
    return x, y
