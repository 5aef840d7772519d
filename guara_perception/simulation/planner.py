"""A simple foothold planner: per leg, the best safe place near where the gait would set the foot."""

from __future__ import annotations

from typing import TYPE_CHECKING

from guara_perception.terrain.grid import TerrainGrid

if TYPE_CHECKING:
    from guara_perception.terrain.questions.best_foothold import Foothold
    from kinematics import RobotModel

# How far from its wish a foot may land: first near, then as far as a wave gait's stride bears.
SEARCH_RADII_M = (0.03, 0.06)
# Beside the wish rather than farther along the path: the legs reach further sideways than the stride leaves ahead.
SIDEWAYS_M = (0.05, -0.05)


def plan_foothold(
    terrain: TerrainGrid,
    leg: str,
    wish: tuple[float, float],
    previous: tuple[float, float] | None = None,
    robot: RobotModel | None = None,
) -> Foothold | None:
    """Choose where to set a foot.

    Args:
        terrain: the newest grid, extent "map" for the hind feet's sake.
        leg: name of the leg, so that its reach counts.
        wish: x and y where the gait would set the foot, in base_footprint of the grid [m].
        previous: what was chosen before for this swing, kept unless something is clearly better.
        robot: whose legs; None = the robot that the grid names.

    Returns:
        The foothold, or None when there is no safe one within reach.

    Raises:
        InvalidInput: a wish that is not finite, a leg that the robot does not have.
    """
    x, y = wish
    for radius in SEARCH_RADII_M:
        found = terrain.best_foothold(x, y, radius, leg=leg, previous=previous, robot=robot)
        if found is not None:
            return found
    # Towards the middle of the body first: there the ground was seen, outside it may not have been.
    for aside in sorted(SIDEWAYS_M, key=lambda aside: abs(y + aside)):
        found = terrain.best_foothold(x, y + aside, SEARCH_RADII_M[-1], leg=leg, previous=previous, robot=robot)
        if found is not None:
            return found
    return None
