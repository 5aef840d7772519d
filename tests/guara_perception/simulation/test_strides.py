"""Tests of strides that are fitted to the ground; `tests/examples/test_stride_planner.py` crosses whole courses."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.exceptions import InvalidInput
from guara_perception.simulation.footing import Footing, around
from guara_perception.simulation.gait import WaveGait, stand_on
from guara_perception.simulation.strides import JOINT_MARGIN, LEAST_WAY_M, LOWER_M, MARGINS_M, StridePlanner
from guara_perception.terrain.layers.record import ScanRecord
from kinematics import RobotModel, polygon_margin
from kinematics.transforms import transform_points
from tests.guara_perception.terrain.map.poses import stance_metadata


def standing(
    robot: RobotModel, soles: dict[str, tuple[float, float]], heights: np.ndarray | None = None
) -> gp.TerrainGrid:
    """A map, level where no heights are given, on which the robot stands with its soles there, body at x = 0."""
    terrain = gp.assess_terrain(np.zeros((140, 320)) if heights is None else heights, 0.005, origin=(-0.6, -0.35))
    _, joints = stand_on(robot, {leg: np.array([*xy, 0.0]) for leg, xy in soles.items()}, (0.0, 0.0), 0.36)
    metadata = {**terrain.metadata, "robot": robot.name, **stance_metadata(robot, joints)}
    return dataclasses.replace(terrain, record=ScanRecord.from_json(metadata))


def test_a_stride_is_in_balance_and_in_reach(robot: RobotModel) -> None:
    """Eight strides over level ground: every leg swings, ahead, over three feet that carry the body, within reach."""
    planner, soles, swung = StridePlanner(robot), WaveGait.of(robot).first_stance(), []
    for _ in range(8):
        stride = planner.next_stride(standing(robot, soles))
        assert stride is not None and stride.swing
        standing_feet = [xy for leg, xy in soles.items() if leg != stride.leg]
        com = transform_points(stride.body, robot.state(robot.posture("scan")).centre_of_mass_in_base)
        assert polygon_margin(standing_feet, com[:2]) >= MARGINS_M[-1] - 1e-9
        assert stride.target[0] - soles[stride.leg][0] > LEAST_WAY_M
        np.testing.assert_allclose(stride.swing.points[-1], stride.target, atol=1e-9)
        for leg, place in {**soles, stride.leg: tuple(stride.target[:2])}.items():
            reach = robot.reach_from(leg, [*place, 0.0], stride.body)
            columns = [robot.tree.joint_index(joint) for joint in robot.tree.leg(leg).joints]
            lower, upper = robot.tree.lower_limits[columns], robot.tree.upper_limits[columns]
            assert (reach.joint_positions > lower + JOINT_MARGIN).all()
            assert (reach.joint_positions < upper - JOINT_MARGIN).all()
        soles[stride.leg] = tuple(stride.target[:2])
        shift = stride.body[:2, 3]
        soles = {leg: (xy[0] - shift[0], xy[1] - shift[1]) for leg, xy in soles.items()}
        swung.append(stride.leg)
    assert set(swung) == set(robot.legs)


def test_a_robot_at_the_end_of_its_reach_walks_on(robot: RobotModel) -> None:
    """lf is stretched back as far as rh is stretched forward, so that hardly another body reaches both."""
    soles = {"lf": (0.106, 0.228), "rf": (0.389, -0.182), "lh": (-0.151, 0.232), "rh": (-0.113, -0.184)}
    stride = StridePlanner(robot).next_stride(standing(robot, soles))
    assert stride is not None and stride.swing and stride.target[0] - soles[stride.leg][0] > LEAST_WAY_M


@pytest.mark.parametrize("far", [0.57, 0.58])
def test_knees_stay_bent_at_the_end_of_their_reach(robot: RobotModel, far: float) -> None:
    """One row of footholds is left: on ground 5 mm lower than was planned all joints still keep their margin."""
    feet = robot.state(robot.posture("scan")).soles_in_base() * (1.0, 1.0, 0.0)
    x, y = around(np.zeros(3))
    level, row = np.zeros((x.size, y.size)), np.broadcast_to(np.abs(x[:, None] - far) < 0.003, (x.size, y.size))
    stride = StridePlanner(robot).next_step(Footing(x, y, level, row, level + 0.05, level, level), feet)
    assert stride is not None
    feet[robot.legs.index(stride.leg)] = stride.target
    for leg, foot in zip(robot.legs, feet, strict=True):
        joints = robot.reach_from(leg, foot - (0.0, 0.0, LOWER_M), stride.body).joint_positions
        lower = robot.tree.lower_limits[[robot.tree.joint_index(joint) for joint in robot.tree.leg(leg).joints]]
        assert (joints > lower + JOINT_MARGIN).all()


def test_no_foot_goes_where_the_ground_is_unknown(robot: RobotModel) -> None:
    """Ground is unknown from just before the fore feet on: the robot comes up to it, and no foot goes in."""
    soles, border, planner = WaveGait.of(robot).first_stance(), 0.40, StridePlanner(robot)
    for _ in range(12):
        heights = np.zeros((140, 320))
        heights[:, round((border + 0.6) / 0.005) :] = np.nan
        stride = planner.next_stride(standing(robot, soles, heights))
        if stride is None:
            break
        assert stride.target[0] < border - robot.sole[0] / 2
        shift = stride.body[:2, 3]
        soles[stride.leg] = tuple(stride.target[:2])
        soles = {leg: (xy[0] - shift[0], xy[1] - shift[1]) for leg, xy in soles.items()}
        border -= shift[0]
    assert border < 0.36 and max(xy[0] for xy in soles.values()) > border - 0.15


def test_robots_of_other_builds_are_refused(robot: RobotModel) -> None:
    """The planner balances on three feet of four."""
    biped = SimpleNamespace(name="biped", legs=("l", "r"))
    with pytest.raises(InvalidInput, match="robot 'biped' has 2 legs; allowed: 4, for the stride planner"):
        StridePlanner(biped)  # type: ignore[arg-type]


def test_a_grid_without_a_stance_is_refused(robot: RobotModel) -> None:
    """The message says what is needed."""
    with pytest.raises(InvalidInput, match="the grid's record has no stance; give the map of a walk"):
        StridePlanner(robot).next_stride(gp.assess_terrain(np.zeros((20, 20)), 0.005))
