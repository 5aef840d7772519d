"""Simple foot planner: best safe foothold of a leg near the gait's nominal foothold, and a swing to it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.questions.best_foothold import Foothold
from guara_perception.terrain.questions.leg_reach import standing_sole
from guara_perception.terrain.questions.reason import Reason
from guara_perception.terrain.questions.swing import Swing
from kinematics import RobotModel

# Search radii around the nominal foothold, in the order of search: close to it, then as far as the wave gait allows.
SEARCH_RADII_M = (0.03, 0.06)
# Lateral offsets of the circles searched next. A leg reaches farther sideways than the gait allows forwards.
SIDEWAYS_M = (0.05, -0.05)
# Offsets and radius of the circles searched last, if no swing to the footholds found before is accepted.
OTHER_OFFSETS_M = tuple((dx, dy) for dx in (0.0, -0.04, 0.04) for dy in (0.0, 0.04, -0.04, 0.08, -0.08))
OTHER_RADIUS_M = 0.02
# Clearances of a swing over the ground, in the order of trial.
SWING_CLEARANCES_M = (0.030, 0.020)


@dataclass(frozen=True, slots=True, eq=False)
class PlannedSwing:
    """Foothold and an accepted swing to it.

    Attributes:
        foothold: chosen foothold.
        swing: path of the sole to the foothold.
        clearance: clearance with which the swing was accepted [m].
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
    """Choose the best safe foothold of a leg near the nominal one.

    Args:
        terrain: newest grid, of extent "map" because a single scan does not show the ground under the hind feet.
        leg: name of the leg, whose reach is checked; None = do not check the reach.
        wish: x and y of the gait's nominal foothold, in base_footprint of the grid [m].
        previous: foothold chosen before for this swing. While it is safe and in the circle searched, it is kept unless
            another foothold there is clearly better.
        robot: model of the robot; None = the robot that the grid names.

    Returns:
        The foothold; None if there is no safe one in the circles searched.

    Raises:
        InvalidInput, kinematics.KinematicsError: as in `TerrainGrid.best_foothold`.
    """
    return next(_best_first(terrain, leg, wish, previous, robot), None)


def plan_swing(
    terrain: TerrainGrid,
    leg: str,
    wish: tuple[float, float],
    previous: tuple[float, float] | None = None,
    robot: RobotModel | None = None,
) -> PlannedSwing | None:
    """Choose the first foothold, in the order of search, to which a swing is accepted; return it with that swing.

    Args:
        terrain: newest grid, whose record must contain the stance of its pause; the swing begins at the standing sole.
        leg, wish, previous, robot: as in `plan_foothold`.

    Returns:
        Foothold and swing; None if no swing to any of the footholds found is accepted.

    Raises:
        InvalidInput, kinematics.KinematicsError: as in `plan_foothold` and `TerrainGrid.swing`.
    """
    start = standing_sole(terrain, leg, robot)
    tried: set[tuple[float, float]] = set()
    sources = _best_first(terrain, leg, wish, previous, robot), _others(terrain, leg, wish, robot)
    for foothold in (found for source in sources for found in source):
        if (foothold.x, foothold.y) in tried:
            continue
        tried.add((foothold.x, foothold.y))
        for clearance in SWING_CLEARANCES_M:
            swing = terrain.swing(start, foothold.position, clearance, leg, robot)
            if swing.ok:
                return PlannedSwing(foothold, swing, clearance)
    return None


def refusals(
    terrain: TerrainGrid, leg: str, wish: tuple[float, float], robot: RobotModel | None = None
) -> tuple[Reason, ...]:
    """Reasons why `plan_swing` found nothing.

    They are those of a swing, tried with the smallest clearance, to the foothold of `plan_foothold`. If there is none,
    they are those of the nominal foothold.
    """
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
    """Yield the best foothold of each circle: around the nominal foothold, small and wide, then to the sides."""
    x, y = wish
    # Search towards the centre line first, because ground farther out may not have been scanned.
    sideways = sorted(SIDEWAYS_M, key=lambda aside: abs(y + aside))
    circles = [(0.0, radius) for radius in SEARCH_RADII_M] + [(aside, SEARCH_RADII_M[-1]) for aside in sideways]
    for aside, radius in circles:
        found = terrain.best_foothold(x, y + aside, radius, leg=leg, previous=previous, robot=robot)
        if found is not None:
            yield found


def _others(terrain: TerrainGrid, leg: str, wish: tuple[float, float], robot: RobotModel | None) -> Iterator[Foothold]:
    """Yield the best foothold of each circle of OTHER_OFFSETS_M, nearest circle first."""
    for dx, dy in sorted(OTHER_OFFSETS_M, key=lambda offset: (np.hypot(*offset), abs(wish[1] + offset[1]))):
        found = terrain.best_foothold(wish[0] + dx, wish[1] + dy, OTHER_RADIUS_M, leg=leg, robot=robot)
        if found is not None:
            yield found
