"""Tests of the simple foothold planner."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.exceptions import InvalidInput
from guara_perception.simulation.planner import plan_foothold, plan_swing, refusals
from guara_perception.terrain.layers.record import ScanRecord
from kinematics import RobotModel, load_robot
from tests.guara_perception.terrain.map.poses import stance_metadata

WISH = (0.405, -0.18)


@pytest.fixture(scope="module")
def robot() -> RobotModel:
    return load_robot("guara")


def ground(robot: RobotModel, *holes: tuple[float, float, float, float]) -> gp.TerrainGrid:
    """Level ground that says how the robot stands on it; holes (x0, x1, y0, y1) are unknown."""
    elevation = np.zeros((140, 320))
    for x0, x1, y0, y1 in holes:
        columns = slice(round((x0 + 0.6) / 0.005), round((x1 + 0.6) / 0.005))
        rows = slice(round((y0 + 0.35) / 0.005), round((y1 + 0.35) / 0.005))
        elevation[rows, columns] = np.nan
    terrain = gp.assess_terrain(elevation, 0.005, origin=(-0.6, -0.35))
    metadata = {**terrain.metadata, "robot": robot.name, **stance_metadata(robot)}
    return dataclasses.replace(terrain, record=ScanRecord.from_json(metadata))


def test_on_good_ground_the_wish_is_granted(robot: RobotModel) -> None:
    """Nothing in the way: the foot goes where the gait wants it, within a cell."""
    found = plan_foothold(ground(robot), "rf", WISH, robot=robot)
    assert found is not None
    assert np.hypot(found.x - WISH[0], found.y - WISH[1]) < 0.006


def test_a_foot_is_set_beside_a_hole(robot: RobotModel) -> None:
    """A hole at the wish sends the foot beside it, near; a wide one sideways, further than the first radius."""
    small = ground(robot, (0.395, 0.415, -0.19, -0.17))
    found = plan_foothold(small, "rf", WISH, robot=robot)
    assert found is not None
    assert small.is_traversable(found.x, found.y)
    # Half the hole, half the sole and a cell of margin, to the nearest side.
    assert 0.04 < np.hypot(found.x - WISH[0], found.y - WISH[1]) < 0.08
    wide = ground(robot, (0.30, 0.50, -0.22, -0.14))
    found = plan_foothold(wide, "rf", WISH, robot=robot)
    assert found is not None
    assert wide.is_traversable(found.x, found.y)
    assert found.y > -0.14 + 0.03


def test_where_nothing_is_safe_there_is_no_foothold(robot: RobotModel) -> None:
    """Unknown ground all around, or a wish out of reach, gives None; a wish that is not finite is refused."""
    assert plan_foothold(ground(robot, (0.1, 0.8, -0.34, 0.2)), "rf", WISH, robot=robot) is None
    assert plan_foothold(ground(robot), "rf", (0.75, -0.18), robot=robot) is None
    with pytest.raises(InvalidInput, match="it must be finite"):
        plan_foothold(ground(robot), "rf", (np.nan, 0.0), robot=robot)


def test_a_choice_is_kept(robot: RobotModel) -> None:
    """A foothold chosen before stays while it is as good as any other."""
    terrain = ground(robot)
    kept = plan_foothold(terrain, "rf", WISH, previous=(0.41, -0.175), robot=robot)
    assert kept is not None
    assert (kept.x, kept.y) == pytest.approx((0.41, -0.175))


def test_a_swing_leads_over_what_lies_between(robot: RobotModel) -> None:
    """A board of 40 mm across the way: the swing goes over it with its clearance, from the sole to the foothold."""
    terrain = ground(robot)
    heights = np.zeros(terrain.shape)
    heights[20:50, 186:190] = 0.04
    board = dataclasses.replace(
        gp.assess_terrain(heights, 0.005, origin=(-0.6, -0.35)),
        record=ScanRecord.from_json(terrain.metadata),
        extent="map",
    )
    planned = plan_swing(board, "rf", WISH, robot=robot)
    assert planned is not None
    np.testing.assert_allclose(planned.swing.points[0], (0.30, -0.18, 0.0), atol=0.002)
    np.testing.assert_allclose(planned.swing.points[-1], planned.foothold.position)
    assert planned.swing.points[:, 2].max() >= 0.04 + planned.clearance
    assert board.check_path(planned.swing.points, planned.clearance).ok


@pytest.mark.slow
def test_where_the_straight_way_is_barred_another_is_found(robot: RobotModel) -> None:
    """Unknown ground on the straight way is never crossed; where it lies all across there is no swing but a reason."""
    narrow = ground(robot, (0.342, 0.352, -0.186, -0.176))
    wanted = plan_foothold(narrow, "rf", WISH, robot=robot)
    assert wanted is not None
    x, y, z = wanted.position
    assert not narrow.check_path([[0.30, -0.18, 0.0], [0.30, -0.18, 0.06], [x, y, 0.06], [x, y, z]], 0.02).ok
    planned = plan_swing(narrow, "rf", WISH, robot=robot)
    assert planned is not None
    assert narrow.check_path(planned.swing.points, planned.clearance).ok
    across = ground(robot, (0.345, 0.350, -0.35, 0.35))
    assert plan_swing(across, "rf", (0.44, -0.18), robot=robot) is None
    assert {reason.test for reason in refusals(across, "rf", (0.44, -0.18), robot)} == {"unknown"}
    assert refusals(ground(robot), "rf", (0.75, -0.18), robot)[0].test == "reach"
