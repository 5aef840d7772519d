"""Tests of gait, stand and the kinematic walk."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from guara_perception.exceptions import InvalidInput
from guara_perception.simulation.features import Box, Step
from guara_perception.simulation.gait import OutOfReach, WaveGait, body_pose, stand_on
from guara_perception.simulation.walk import Choice, Landing, WalkEnded, WalkNoise, WalkPause, simulate_walk
from guara_perception.simulation.world import World
from kinematics import RobotModel, load_robot
from testbed.random_world import random_world
from tests.thorough import examples

EXACT = WalkNoise(joint=0.0, contact=0.0, slip=0.0, imu=0.0, slide=0.0)


@pytest.fixture(scope="module")
def robot() -> RobotModel:
    return load_robot("guara")


def test_the_gait_is_that_of_the_paper(robot: RobotModel) -> None:
    """RH, RF, LH, LF; 140 mm per cycle."""
    gait = WaveGait.of(robot)
    assert gait.lift_order == ("rh", "rf", "lh", "lf")
    assert [gait.leg_of_swing(n) for n in range(5)] == ["rh", "rf", "lh", "lf", "rh"]
    assert 4 * gait.advance == pytest.approx(0.140)


def test_on_level_ground_the_walk_repeats_every_cycle(robot: RobotModel) -> None:
    """Without noise each cycle ends as it began, 140 mm further on, with the body level at 0.36 m."""
    pauses = list(simulate_walk(World(), robot, cycles=3, noise=EXACT))
    assert [pause.step for pause in pauses] == list(range(13))
    for one, later in zip(pauses, pauses[4:], strict=False):
        for joint, value in one.joint_positions.items():
            assert later.joint_positions[joint] == pytest.approx(value, abs=1e-9)
        moved = later.transform_base_to_world - one.transform_base_to_world
        np.testing.assert_allclose(moved[:3, 3], [0.140, 0, 0], atol=1e-12)
        np.testing.assert_allclose(later.transform_base_to_world[:3, :3], np.eye(3), atol=1e-12)
        assert later.transform_base_to_world[2, 3] == pytest.approx(0.36)
        assert later.nominal == pytest.approx(one.nominal)


@settings(max_examples=examples(8), deadline=None, derandomize=True)
@given(seed=st.integers(0, 200))
def test_the_joints_put_every_sole_where_it_stands(robot: RobotModel, seed: int) -> None:
    """Forward kinematics of the true joints and pose gives the true soles, level, resting on the ground."""
    world = random_world(seed, boxes=0, pits=0, rocks=0, undulation=0.004)
    for pause in simulate_walk(world, robot, cycles=1, seed=seed):
        state = robot.state(pause.joint_positions)
        assert not state.beyond_limits
        transform = pause.transform_base_to_world
        for leg, sole in pause.soles_in_world.items():
            sole_pose = transform @ state.transform_to_base(robot.tree.leg(leg).sole)
            np.testing.assert_allclose(sole_pose[:3, 3], sole, atol=1e-9)
            assert abs(sole_pose[2, 0]) < 1e-9
            assert sole[2] == pytest.approx(world.sole_height(sole[0], sole[1], *robot.sole), abs=0.003)


def test_one_foot_moves_and_three_stay(robot: RobotModel) -> None:
    """Between two pauses only the announced leg's sole moves; it lands where it was commanded to."""

    def choose(pause: WalkPause) -> tuple[float, float]:
        return pause.nominal[0] + 0.02, pause.nominal[1] - 0.01

    pauses = list(simulate_walk(World(), robot, choose, cycles=2, noise=WalkNoise(slide=0.0)))
    for one, two in itertools.pairwise(pauses):
        moved = [leg for leg in robot.legs if (one.soles_in_world[leg] != two.soles_in_world[leg]).any()]
        assert moved == [one.next_leg]
        footstep = two.last_footstep
        assert footstep is not None
        assert footstep.leg == one.next_leg
        assert footstep.target_in_footprint == pytest.approx((one.nominal[0] + 0.02, one.nominal[1] - 0.01))
        wanted = one.to_world(*footstep.target_in_footprint)
        np.testing.assert_allclose(footstep.sole_in_world[:2], wanted, atol=6 * WalkNoise().slip)


def test_standing_feet_slide_by_a_share_drawn_for_each_walk(robot: RobotModel) -> None:
    """All together, up to 8 % of the way and either way; the same seed draws the same share."""
    shares = []
    for seed in (*range(6), 0):
        one, two = simulate_walk(World(), robot, cycles=0.25, seed=seed)
        stood = [leg for leg in robot.legs if leg != one.next_leg]
        ways = np.array([two.soles_in_world[leg] - one.soles_in_world[leg] for leg in stood])
        np.testing.assert_allclose(ways, ways[[0, 0, 0]], atol=1e-12)
        np.testing.assert_allclose(ways[0, 1:], 0.0, atol=1e-12)
        shares.append(-ways[0, 0] / 0.035)
    assert shares[0] == shares[-1]
    assert -0.08 <= min(shares) < -0.01 and 0.01 < max(shares) <= 0.08


def test_known_ground_is_declared_once_around_the_first_stance(robot: RobotModel) -> None:
    """At the first pause the gait declares the ground under its feet and up to where scans begin; never again."""
    pauses = list(simulate_walk(World(), robot, cycles=1))
    (ground,) = pauses[0].known_ground
    assert not any(pause.known_ground for pause in pauses[1:])
    low, high = ground.outline.min(axis=0), ground.outline.max(axis=0)
    for sole in pauses[0].soles_in_world.values():
        assert (sole[:2] > low + 0.06).all()
        assert (sole[:2] < high - 0.06).all()
    assert high[0] >= robot.config.root.table("grid").table("footprint").pair("x")[0]
    assert ground.height == 0.0


@pytest.mark.slow
def test_reports_are_noisy_as_stated(robot: RobotModel) -> None:
    """Reported joints and gravity scatter about the truth as stated; without an IMU there is no gravity."""
    noise = WalkNoise(joint=0.01, imu=0.002)
    joints, gravity = [], []
    for pause in simulate_walk(World(), robot, cycles=40, noise=noise):
        joints += [pause.stance.joint_positions[name] - value for name, value in pause.joint_positions.items()]
        assert pause.stance.gravity_in_base is not None
        gravity.append(np.array(pause.stance.gravity_in_base)[:2] + pause.transform_base_to_world[2, :2])
    assert np.std(joints) == pytest.approx(0.01, rel=0.05)
    assert np.std(gravity) == pytest.approx(0.002, rel=0.15)
    blind = next(simulate_walk(World(), robot, noise=WalkNoise(imu=None)))
    assert blind.stance.gravity_in_base is None


def test_the_body_follows_the_ground(robot: RobotModel) -> None:
    """On a board under the left feet the body rolls to the right; over a step up it pitches nose up."""
    board = World(features=(Box(x=0.0, y=0.2, size=(1.2, 0.2), height=0.02),))
    pause = next(simulate_walk(board, robot, noise=EXACT))
    roll = np.arctan2(pause.transform_base_to_world[2, 1], pause.transform_base_to_world[2, 2])
    assert roll == pytest.approx(np.arctan(0.02 / 0.36), abs=1e-6)
    up = next(simulate_walk(World(features=(Step(x=0.1, height=0.02),)), robot, noise=EXACT))
    assert up.transform_base_to_world[2, 0] > 0.02


def test_the_same_seed_walks_the_same_walk(robot: RobotModel) -> None:
    """Noise repeats with its seed and differs with another."""
    one, again, other = (
        [p.stance.joint_positions["lf_kfe_joint"] for p in simulate_walk(World(), robot, cycles=1, seed=s)]
        for s in (1, 1, 2)
    )
    assert one == again
    assert one != other


def test_a_walk_without_foothold_ends(robot: RobotModel) -> None:
    """When the planner finds nothing, the walk says where and for which leg; what is out of reach is refused."""
    walk = simulate_walk(World(), robot, lambda pause: None)
    next(walk)
    with pytest.raises(
        WalkEnded, match=r"step 0: the planner found no safe foothold for leg 'rh' near x -0.195, y -0.18"
    ):
        next(walk)
    walk = simulate_walk(World(), robot, lambda pause: (pause.nominal[0] + 0.3, pause.nominal[1]))
    next(walk)
    with pytest.raises(OutOfReach, match="leg 'rh' cannot reach its foothold .* choose a foothold nearer to the hip"):
        next(walk)
    with pytest.raises(InvalidInput, match="walk noise: slip is -1, allowed: finite values of 0 or more"):
        WalkNoise(slip=-1)


def test_a_body_crouches_for_a_foot_far_out(robot: RobotModel) -> None:
    """A foothold beyond reach at full height is reached with a lower body."""
    gait = WaveGait.of(robot)
    soles = {leg: np.array([*hip, 0.0]) for leg, hip in gait.hips.items()}
    soles["lf"] = soles["lf"] + [0.17, 0, 0]
    transform, joints = stand_on(robot, soles, (0.0, 0.0), 0.36)
    assert 0.30 <= transform[2, 3] < 0.36
    assert not robot.state(joints).beyond_limits


def test_body_pose_is_parallel_to_its_feet() -> None:
    """The body's z axis is the normal of the plane through the soles, along which its height is measured."""
    x, y = np.array([0.3, 0.3, -0.3, -0.3]), np.array([0.18, -0.18, 0.18, -0.18])
    soles = np.column_stack((x, y, 0.05 * x - 0.03 * y + 0.1))
    transform = body_pose(soles, (0.02, 0.01), 0.36)
    wanted = np.array([-0.05, 0.03, 1]) / np.linalg.norm([-0.05, 0.03, 1])
    np.testing.assert_allclose(transform[:3, 2], wanted, atol=1e-12)
    np.testing.assert_allclose(transform[:3, :3] @ transform[:3, :3].T, np.eye(3), atol=1e-12)
    distance = (transform[:3, 3] - soles.mean(axis=0)) @ wanted
    assert distance == pytest.approx(0.36)
    assert transform[1, 0] == 0


def test_a_planner_may_choose_leg_and_body(robot: RobotModel) -> None:
    """The body goes where it is told, then on as the gait does; the nominal landing follows it."""
    gait = WaveGait.of(robot)
    order = gait.lift_order
    chosen = iter([(order[2], (0.060, 0.020)), None, (order[1], (0.0, -0.010)), None])

    def choose(pause: WalkPause) -> Choice:
        move = next(chosen)
        if move is None:
            return pause.nominal
        (x, y), (leg, body) = gait.landing(move[0]), move
        return Landing(x + body[0], y, leg, body)

    pauses = list(simulate_walk(World(), robot, choose, cycles=0.75, noise=EXACT))
    bodies = [pause.transform_base_to_world[:2, 3].tolist() for pause in pauses]
    np.testing.assert_allclose(bodies, [[0.0, 0.0], [0.060, 0.020], [0.095, 0.020], [0.095, 0.010]], atol=1e-9)
    assert pauses[1].to_world(*pauses[1].nominal)[0] == pytest.approx(0.095 + gait.landing(pauses[1].next_leg)[0])
    swung = [pause.last_footstep.leg for pause in pauses[1:] if pause.last_footstep]
    assert swung == [order[2], order[1], order[1]]
