"""Next foothold of each leg from a simple planner, for views and markers."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from guara_perception.terrain.grid import TerrainGrid
    from kinematics import RobotModel


def planned_footholds(robot: RobotModel, terrain: TerrainGrid) -> dict[str, tuple[float, float, float]]:
    """Next foothold (x, y, z) in base_footprint [m] by leg, where a simple planner finds one on this grid.

    Empty if the record of the grid lacks the robot, its stance, its limits or its transform to the footprint.
    """
    from guara_perception.simulation.gait import WaveGait
    from guara_perception.simulation.planner import plan_foothold

    record = terrain.record
    if None in (record.robot, record.stance, record.limits) or record.transform_base_to_footprint is None:
        return {}
    gait = WaveGait.of(robot)
    planned = {}
    for leg in robot.legs:
        x, y = gait.landing(leg)
        found = plan_foothold(terrain, leg, (x + gait.advance, y), robot=robot)
        if found is not None:
            planned[leg] = (found.x, found.y, found.z)
    return planned
