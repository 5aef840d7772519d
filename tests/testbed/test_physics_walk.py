"""Tests of the walk in MuJoCo, and of perception on it from end to end."""

from __future__ import annotations

import itertools
from importlib.util import find_spec

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.exceptions import InvalidInput, MissingExtra, optional_library
from guara_perception.simulation.features import Box, Patch, Rock
from guara_perception.simulation.walk import WalkNoise
from guara_perception.simulation.world import World
from kinematics import LegOdometry, RobotModel, load_robot
from testbed.erring_walk import pictured
from testbed.physics.physics_figures import physics_figures, rms
from testbed.physics.physics_robot import PhysicsRobot
from testbed.physics.physics_walk import physics_walk
from testbed.physics.robot import go2
from testbed.stock_robots import has_stock_robot

# `find_spec` does not import it, which takes seconds in each worker that collects this file.
needs_mujoco = pytest.mark.skipif(find_spec("mujoco") is None, reason="MuJoCo is not installed (extra `sim`)")
needs_go2 = pytest.mark.skipif(not has_stock_robot("go2"), reason="the Go2 is not installed (extra `robots-test`)")
pytestmark = [pytest.mark.sim, pytest.mark.heavy, needs_mujoco]


@pytest.fixture(scope="module")
def robot() -> RobotModel:
    return load_robot("guara")


def standing(height: float = 0.36) -> np.ndarray:
    transform = np.eye(4)
    transform[2, 3] = height
    return transform


def test_a_standing_robot_stands(robot: RobotModel) -> None:
    """Held by its servos the robot keeps its posture and position: it sags by a few millimetres and stays level."""
    posture = robot.posture("scan")
    body = PhysicsRobot(World(), robot, standing(), posture)
    body.run(posture, 2.0)
    transform = body.transform_base_to_world
    np.testing.assert_allclose(transform[:3, 3], [0, 0, 0.36], atol=0.006)
    assert transform[2, 2] > np.cos(0.01)
    assert body.time == pytest.approx(2.0)
    for joint, value in body.joint_positions.items():
        assert value == pytest.approx(posture[joint], abs=0.06)


def test_boxes_carry_the_robot(robot: RobotModel) -> None:
    """On a box under all four feet the body stands higher by the box's height."""
    posture = robot.posture("scan")
    table = World(features=(Box(x=0.0, y=0.0, size=(0.9, 0.6), height=0.05),))
    heights = []
    for world, ground in ((World(), 0.0), (table, 0.05)):
        body = PhysicsRobot(world, robot, standing(0.36 + ground), posture)
        body.run(posture, 1.5)
        heights.append(body.transform_base_to_world[2, 3])
    assert heights[1] - heights[0] == pytest.approx(0.05, abs=1e-3)


def test_the_walk_advances_in_its_lanes(robot: RobotModel) -> None:
    """Two cycles on level ground: 75 to 105 % of 280 mm ahead, feet in their lanes, one foot moved between pauses."""
    pauses = list(physics_walk(World(), robot, cycles=2, noise=WalkNoise(joint=0, imu=0)))
    moved = pauses[-1].transform_base_to_world[0, 3] - pauses[0].transform_base_to_world[0, 3]
    assert 0.75 * 0.28 < moved < 1.05 * 0.28
    for one, two in itertools.pairwise(pauses):
        shifts = {leg: np.linalg.norm(two.soles_in_world[leg] - one.soles_in_world[leg]) for leg in robot.legs}
        assert max(shifts, key=shifts.__getitem__) == one.next_leg
        assert shifts[one.next_leg] > 0.09
        assert all(shift < 0.002 for leg, shift in shifts.items() if leg != one.next_leg)
        for leg, sole in two.soles_in_world.items():
            assert abs(abs(sole[1]) - 0.18) < 0.03
            assert (sole[1] > 0) == leg.startswith("l")
        gravity = np.array(two.stance.gravity_in_base)
        np.testing.assert_allclose(gravity, -two.transform_base_to_world[2, :3], atol=1e-9)


@pytest.mark.robots
@pytest.mark.parametrize("name", ["guara", pytest.param("go2", marks=needs_go2)])
def test_feet_stand_that_share_forces_and_creep_that_do_not(name: str) -> None:
    """A standing foot slides by less than 0.8 mm a pause; by position servos further, all the same way."""
    model = load_robot("guara") if name == "guara" else go2()
    by_forces, by_servos = (
        [slip for pause in physics_walk(World(), model, cycles=2, is_stiff=stiff) for slip in pause.slips.values()]
        for stiff in (False, True)
    )
    assert len(by_forces) == len(by_servos) == 24
    assert np.mean(by_forces) < 0.0004 and max(by_forces) < 0.0008
    assert np.mean(by_servos) > 0.0008


def test_physics_repeats(robot: RobotModel) -> None:
    """The same walk gives the same joints, bit for bit."""
    one, two = ([pause.joint_positions for pause in physics_walk(World(), robot, cycles=0.5, seed=3)] for _ in range(2))
    assert one == two


def test_perception_on_the_physics_walk_is_safe_and_true() -> None:
    """Six cycles over boxes: a grid at every pause, no unknown cell traversable, 5 mm rms under the front feet."""
    figures = physics_figures(3)
    assert figures.grids == 25
    assert figures.unsafe == 0
    assert len(figures.front) >= 4
    assert rms(figures.front) <= 0.005


def test_pictures_hold_a_walk_whose_feet_slide(robot: RobotModel) -> None:
    """In three cycles odometry errs by 8 mm and more, the map that sees pictures by less than 1 mm."""
    terrain_map, odometry = gp.TerrainMap(robot), LegOdometry(robot)
    poses, truths = [], []
    for pause in pictured(robot, 105, 3.0, None, None, crawl="stiff"):
        poses.append(odometry.update(pause.stance))
        fused = terrain_map.update(pause.scan, poses[-1], picture=pause.picture)
        truths.append(pause.to_world)
    way = np.linalg.inv(truths[0]) @ truths[-1]
    by_legs, by_map = (
        np.linalg.norm((np.asarray(transform) - way)[:2, 3])
        for transform in (poses[-1].transform_footprint_to_odom, fused.metadata["transform_footprint_to_odom"])
    )
    assert by_legs > 0.008
    assert by_map < 0.001


def test_what_physics_cannot_do_is_refused(robot: RobotModel) -> None:
    """Worlds beyond boxes, and a missing library, are refused with what is allowed."""
    posture = robot.posture("scan")
    rock = World(features=(Patch(x=0.5, y=0, size=(0.1, 0.1)), Rock(x=0.7, y=0, size=(0.1, 0.1), height=0.03)))
    with pytest.raises(InvalidInput, match="the world has a rock; allowed in MuJoCo: boxes, pits and patches"):
        PhysicsRobot(rock, robot, standing(), posture)
    with pytest.raises(InvalidInput, match="undulation of the world is 0.01 m; allowed in MuJoCo: 0"):
        PhysicsRobot(World(undulation=0.01), robot, standing(), posture)
    with pytest.raises(MissingExtra, match=r"the dance needs no_such_library: pip install 'guara-perception\[sim\]'"):
        optional_library("no_such_library", "sim", "the dance")
