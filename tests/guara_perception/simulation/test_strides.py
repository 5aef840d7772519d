"""Tests of strides that are fitted to the ground; `tests/examples/test_stride_planner.py` crosses whole courses."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.exceptions import InvalidInput
from guara_perception.simulation.gait import stand_on
from guara_perception.simulation.strides import LONGEST_STEP, SHORTEST_STEP, StridePlanner
from guara_perception.terrain.layers.record import ScanRecord
from kinematics import RobotModel
from tests.guara_perception.terrain.map.poses import stance_metadata


def level(robot: RobotModel, soles: dict[str, tuple[float, float]]) -> gp.TerrainGrid:
    """A map of level ground on which the robot stands with its soles there, body at x = 0."""
    terrain = gp.assess_terrain(np.zeros((140, 320)), 0.005, origin=(-0.6, -0.35))
    _, joints = stand_on(robot, {leg: np.array([*xy, 0.0]) for leg, xy in soles.items()}, (0.0, 0.0), 0.36)
    metadata = {**terrain.metadata, "robot": robot.name, **stance_metadata(robot, joints)}
    return dataclasses.replace(terrain, record=ScanRecord.from_json(metadata))


def test_a_robot_at_the_end_of_its_reach_walks_on(robot: RobotModel) -> None:
    """lf is stretched back as far as rh is stretched forward, so that no other body reaches both: lf swings."""
    soles = {"lf": (0.106, 0.228), "rf": (0.389, -0.182), "lh": (-0.151, 0.232), "rh": (-0.113, -0.184)}
    stride = StridePlanner(robot).next_stride(level(robot, soles), "lf")
    assert stride.swing is not None and abs(stride.advance) < 0.005
    assert SHORTEST_STEP <= stride.swing.points[-1][0] - soles["lf"][0] <= LONGEST_STEP


def test_a_grid_without_a_stance_is_refused(robot: RobotModel) -> None:
    """The message says what is needed."""
    with pytest.raises(InvalidInput, match="the grid's record has no stance; give the map of a walk"):
        StridePlanner(robot).next_stride(gp.assess_terrain(np.zeros((20, 20)), 0.005), "lf")
