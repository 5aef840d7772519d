"""A standing sole bounds the ground below it: only for the start of its own swing."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.terrain.layers.record import ScanRecord
from guara_perception.terrain.questions.leg_reach import standing_soles
from guara_perception.terrain.questions.path import swing_ground
from kinematics import RobotModel, Stance

MakeGround = Callable[..., gp.TerrainGrid]


@pytest.fixture
def make_ground(robot: RobotModel) -> MakeGround:
    """Level ground around a standing robot, unknown in given rectangles (x0, x1, y0, y1) [m]."""
    stance = Stance(robot.posture("scan"), robot.legs, (0, 0, -1))
    pose = robot.stance_pose(stance)
    metadata: dict[str, Any] = {
        "robot": robot.name,
        "stance": stance.to_dict(),
        "support_feet_used": list(robot.legs),
        "transform_base_to_footprint": pose.transform_base_to_footprint.tolist(),
    }

    def make(unknown: tuple[float, float, float, float], **more: Any) -> gp.TerrainGrid:
        y, x = (np.mgrid[:140, :200] + 0.5) * 0.005 + np.array([-0.35, -0.3])[:, None, None]
        x0, x1, y0, y1 = unknown
        heights = np.where((x > x0) & (x < x1) & (y > y0) & (y < y1), np.nan, 0.0)
        variance = np.full(heights.shape, 1e-7)
        terrain = gp.assess_terrain(heights, 0.005, origin=(-0.3, -0.35), variance=variance)
        return dataclasses.replace(terrain, record=ScanRecord.from_json({**terrain.metadata, **metadata, **more}))

    return make


def way_of(terrain: gp.TerrainGrid, leg: int = 0, aside: float = 0.0) -> np.ndarray:
    """Path up from a sole, over, and down in front."""
    start = standing_soles(terrain)[leg].centre + (aside, 0.0, 0.0)
    end = np.array([start[0] + 0.14, start[1], 0.0])
    top = np.array([0.0, 0.0, 0.06])
    return np.array([start, start + top, end + top, end])


def around(centre: np.ndarray, half_x: float, half_y: float) -> tuple[float, float, float, float]:
    """Rectangle around a sole."""
    return centre[0] - half_x, centre[0] + half_x, centre[1] - half_y, centre[1] + half_y


@pytest.fixture
def sole(make_ground: MakeGround) -> np.ndarray:
    """Centre of the first leg's sole."""
    return standing_soles(make_ground((9, 9, 9, 9)))[0].centre


def test_a_foot_may_lift_off_from_unknown_ground(make_ground: MakeGround, sole: np.ndarray) -> None:
    """The foot stands there, so nothing below it is higher than its sole; a swing is found as well."""
    terrain = make_ground(around(sole, 0.025, 0.02))
    way = way_of(terrain)
    assert np.isnan(terrain.height_at(*way[0, :2]))
    assert terrain.check_path(way, 0.020)
    assert terrain.swing(way[0], way[-1], 0.020)
    assert not terrain.check_foothold(*way[0, :2])


def test_a_bound_from_light_that_passed_higher_takes_nothing_from_the_sole(
    make_ground: MakeGround, sole: np.ndarray
) -> None:
    """With any ceiling below the foot, paths accepted without bounds are accepted with them."""
    terrain = make_ground(around(sole, 0.025, 0.02))
    way = way_of(terrain)
    for height in (0.0, 0.10, np.nan):
        ceiling = np.where(np.isnan(terrain.elevation), np.float32(height), np.float32(np.nan))
        bounded = dataclasses.replace(terrain, layers={**terrain.layers, "ceiling": ceiling})
        assert bounded.check_path(way, 0.020)
        assert bounded.swing(way[0], way[-1], 0.020)


def test_nothing_is_said_beside_the_sole(make_ground: MakeGround, sole: np.ndarray) -> None:
    """Unknown ground that extends beyond the sole still blocks the swing."""
    for half in (0.06, 0.10):
        terrain = make_ground(around(sole, half, half))
        verdict = terrain.check_path(way_of(terrain), 0.020)
        assert [reason.test for reason in verdict.reasons] == ["unknown"]
        assert not terrain.swing(*way_of(terrain)[[0, -1]], 0.020)


def test_only_the_swing_of_that_foot_gains(make_ground: MakeGround, sole: np.ndarray) -> None:
    """For a path that begins elsewhere, above, or passes over a standing foot, the ground stays unknown."""
    terrain = make_ground(around(sole, 0.025, 0.02))
    way = way_of(terrain)
    for other in (way_of(terrain, aside=0.02), way[1:], way[::-1], way + (0, 0, 0.02)):
        assert not terrain.check_path(other, 0.020)


@pytest.mark.parametrize("missing", ["stance", "transform_base_to_footprint", "robot", "support_feet_used"])
def test_without_a_stance_all_is_as_it_was(make_ground: MakeGround, sole: np.ndarray, missing: str) -> None:
    """A grid without a stance, or of an unavailable robot, bounds nothing."""
    way = way_of(make_ground((9, 9, 9, 9)))
    value: Any = [] if missing == "support_feet_used" else "no_such_robot" if missing == "robot" else None
    assert not make_ground(around(sole, 0.025, 0.02), **{missing: value}).check_path(way, 0.020)


def test_known_heights_under_the_sole_stand(make_ground: MakeGround) -> None:
    """Only unknown cells get the height of the sole; observed heights are not lowered."""
    terrain = make_ground((9, 9, 9, 9))
    ground = swing_ground(terrain, standing_soles(terrain)[0].centre)
    np.testing.assert_array_equal(ground.hazard, terrain.hazard)
    np.testing.assert_array_equal(ground.top, terrain.elevation_max)


def test_the_bound_is_the_sole_with_its_error(make_ground: MakeGround, sole: np.ndarray) -> None:
    """Cells wholly under the sole reduced by two sigma of its position have its height and variance."""
    terrain = make_ground(around(sole, 0.08, 0.08))
    standing = standing_soles(terrain)[0]
    ground = swing_ground(terrain, sole)
    iy, ix = np.nonzero(ground.hazard != terrain.hazard)
    x, y = terrain.geometry.centres()
    reach = np.abs(np.column_stack((x[ix], y[iy])) - sole[:2]).max(axis=0) + 0.0025
    assert (reach <= np.array([0.040, 0.030]) - 2 * np.sqrt(np.diag(standing.covariance)[:2]) + 1e-6).all()
    assert (reach > (0.030, 0.020)).all()
    np.testing.assert_allclose(ground.top[iy, ix], sole[2], atol=1e-6)
    np.testing.assert_allclose(ground.variance[iy, ix], standing.covariance[2, 2], rtol=1e-5)
