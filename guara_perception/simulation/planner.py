"""A simple foot planner: per leg, the best safe place near where the gait would set the foot, and a swing there."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.questions.leg_reach import standing_sole

if TYPE_CHECKING:
    from guara_perception.terrain.layers.hazard import Reason
    from guara_perception.terrain.layers.layered_grid import Ceiling
    from guara_perception.terrain.questions.best_foothold import Foothold
    from guara_perception.terrain.questions.swing import Swing
    from kinematics import RobotModel

# How far from its wish a foot may land: first near, then as far as the wave gait allows.
SEARCH_RADII_M = (0.03, 0.06)
# Beside the wish rather than farther along the path: the legs reach further sideways than the gait leaves ahead.
SIDEWAYS_M = (0.05, -0.05)
# Where no swing reaches the best places, others are searched in circles about these offsets, of this radius.
OTHER_OFFSETS_M = tuple((dx, dy) for dx in (0.0, -0.04, 0.04) for dy in (0.0, 0.04, -0.04, 0.08, -0.08))
OTHER_RADIUS_M = 0.02
# Clearances of a swing over the ground, in the order in which they are tried.
SWING_CLEARANCES_M = (0.030, 0.020)


@dataclass(frozen=True, slots=True, eq=False)
class PlannedSwing:
    """A foothold and the way there.

    Attributes:
        foothold: where the foot is set down.
        swing: path of the sole to it, over known ground.
        clearance: clearance with which the swing was checked [m].
    """

    foothold: Foothold
    swing: Swing
    clearance: float


def plan_foothold(
    terrain: TerrainGrid,
    leg: str | None,
    wish: tuple[float, float],
    previous: tuple[float, float] | None = None,
    robot: RobotModel | None = None,
) -> Foothold | None:
    """Choose where to set a foot.

    Args:
        terrain: the newest grid; of extent "map", since a single scan does not show the ground of the hind feet.
        leg: name of the leg, so that its reach counts; None = any place that is safe.
        wish: x and y where the gait would set the foot, in base_footprint of the grid [m].
        previous: foothold chosen before for this swing, kept unless another is clearly better.
        robot: model of the robot; None = the robot that the grid names.

    Returns:
        The foothold, or None when there is no safe one within reach.

    Raises:
        InvalidInput: a wish that is not finite, a leg that the robot does not have.
    """
    return next(_best_first(terrain, leg, wish, previous, robot), None)


def plan_swing(
    terrain: TerrainGrid,
    leg: str,
    wish: tuple[float, float],
    previous: tuple[float, float] | None = None,
    robot: RobotModel | None = None,
    *,
    ceiling: Ceiling | None = None,
) -> PlannedSwing | None:
    """Choose where to set a foot, and how it gets there: the best place to which a swing is accepted.

    Args:
        terrain: the newest grid, with the stance of its pause in its record: the swing begins where the sole stands.
        leg, wish, previous, robot: as in `plan_foothold`.
        ceiling: how high unknown ground can be at most (`LinesOfSight`); None lets no swing pass over any.

    Returns:
        The swing, or None when no safe place within reach can be swung to.

    Raises:
        InvalidInput: as `plan_foothold` and `TerrainGrid.swing`.
    """
    start = standing_sole(terrain, leg, robot)
    tried: set[tuple[float, float]] = set()
    sources = _best_first(terrain, leg, wish, previous, robot), _others(terrain, leg, wish, robot)
    for foothold in (found for source in sources for found in source):
        if (foothold.x, foothold.y) in tried:
            continue
        tried.add((foothold.x, foothold.y))
        for clearance in SWING_CLEARANCES_M:
            swing = terrain.swing(start, foothold.position, clearance, leg, robot, ceiling=ceiling)
            if swing.ok:
                return PlannedSwing(foothold, swing, clearance)
    return None


def refusals(
    terrain: TerrainGrid, leg: str, wish: tuple[float, float], robot: RobotModel | None = None
) -> tuple[Reason, ...]:
    """Reasons for which `plan_swing` found nothing: those of the wish or, where a foothold is near, of the swing."""
    foothold = plan_foothold(terrain, leg, wish, robot=robot)
    if foothold is None:
        return terrain.check_foothold(wish[0], wish[1], leg=leg, robot=robot).reasons
    return terrain.swing(
        standing_sole(terrain, leg, robot), foothold.position, SWING_CLEARANCES_M[-1], leg, robot
    ).reasons


def _best_first(
    terrain: TerrainGrid,
    leg: str | None,
    wish: tuple[float, float],
    previous: tuple[float, float] | None,
    robot: RobotModel | None,
) -> Iterator[Foothold]:
    """Places near the wish, then farther, then beside it."""
    x, y = wish
    # Towards the body's centre line first: there the ground was seen, outside it may not have been.
    sideways = sorted(SIDEWAYS_M, key=lambda aside: abs(y + aside))
    circles = [(0.0, radius) for radius in SEARCH_RADII_M] + [(aside, SEARCH_RADII_M[-1]) for aside in sideways]
    for aside, radius in circles:
        found = terrain.best_foothold(x, y + aside, radius, leg=leg, previous=previous, robot=robot)
        if found is not None:
            yield found


def _others(terrain: TerrainGrid, leg: str, wish: tuple[float, float], robot: RobotModel | None) -> Iterator[Foothold]:
    """The best place of each of these circles, the nearest circle first."""
    for dx, dy in sorted(OTHER_OFFSETS_M, key=lambda offset: (np.hypot(*offset), abs(wish[1] + offset[1]))):
        found = terrain.best_foothold(wish[0] + dx, wish[1] + dy, OTHER_RADIUS_M, leg=leg, robot=robot)
        if found is not None:
            yield found
