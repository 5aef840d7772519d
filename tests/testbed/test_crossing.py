"""Tests of crossings: the courses, the sharing of forces, and walks that end as they must."""

from __future__ import annotations

from importlib.util import find_spec

import numpy as np
import pytest

from guara_perception.exceptions import InvalidInput
from guara_perception.simulation.features import Pit
from guara_perception.simulation.world import World
from kinematics import LegOdometry, Stance
from testbed.crossing.courses import KINDS, SIZES, START_M, course
from testbed.crossing.eyes import Sight
from testbed.crossing.walk import Crossing, cross, edge_distance, support
from testbed.physics.crawl import FRICTION_USED, shared
from testbed.physics.robot import LEGS, Robot, go2
from testbed.stock_robots import has_stock_robot

HAS_GO2 = find_spec("mujoco") is not None and has_stock_robot("go2")
needs_go2 = pytest.mark.skipif(not HAS_GO2, reason="MuJoCo or the Go2 is not installed (sim, robots-test)")
GAP = World(features=(Pit(x=0.5, y=0.0, size=(0.10, 1.0), depth=0.2),))


@pytest.mark.parametrize("kind", KINDS)
def test_courses_are_fixed_by_their_seed(kind: str) -> None:
    """The same seed gives the same ground, level before the field and beyond the goal; another one differs."""
    made = course(kind, 3)
    assert made == course(kind, 3)
    assert made.world != course(kind, 4).world
    x, y = np.meshgrid(
        np.r_[np.linspace(-0.8, START_M - 0.01, 50), np.linspace(made.goal + 0.01, 3.0, 50)], [-0.2, 0.2]
    )
    np.testing.assert_array_equal(made.world.height(x, y), 0.0)


def test_courses_of_a_guara_ask_for_less_height_and_more_ground() -> None:
    """Stairs of 30 to 40 mm, stones half as large again."""
    for seed in range(5):
        steps = {each.top for each in course("stairs", seed, SIZES["guara"]).world.features}
        assert 0.03 <= min(steps) <= 0.04
        stones = [each.size for each in course("stones", seed, SIZES["guara"]).world.features if each.size[0] < 0.5]
        # What gaps leave of the field is shared, so that some are a little shorter.
        assert np.min(stones) > 0.225 and np.max(stones) <= 0.36


def test_an_unknown_course_is_refused() -> None:
    """The message says what there is."""
    with pytest.raises(InvalidInput, match="course is 'lava'; allowed: trenches, stones"):
        course("lava", 0)


def test_shared_forces_give_the_wrench() -> None:
    """Inside the friction cones, and a foot that is not ready carries next to nothing."""
    arms = np.array([[0.2, 0.14, -0.3], [0.2, -0.14, -0.3], [-0.2, 0.14, -0.3], [-0.2, -0.14, -0.3]])
    # On three feet the wrench presses on the middle of their triangle.
    on_four, on_three = np.array([5.0, -3.0, 150.0, 2.0, 1.0, 0.5]), np.array([0.0, 0.0, 150.0, 7.0, -10.0, 0.0])
    for wrench, shares in ((on_four, np.ones(4)), (on_three, np.array([1.0, 1.0, 1.0, 0.0]))):
        forces = shared(arms, wrench, shares)
        np.testing.assert_allclose(forces.sum(axis=0), wrench[:3], atol=1.0)
        np.testing.assert_allclose(np.cross(arms, forces).sum(axis=0), wrench[3:], atol=0.1)
        assert (np.abs(forces[:, :2]).sum(axis=1) <= FRICTION_USED * forces[:, 2] + 1e-9).all()
    assert np.linalg.norm(forces[3]) < 1.0


def test_edges_and_support_are_by_the_true_ground() -> None:
    """A target over a gap has its distance below zero; a sole half over an edge has half of its support."""
    distance, is_over = edge_distance(GAP, np.array([0.42, 0.0, 0.0]))
    assert distance == pytest.approx(0.030, abs=0.0015) and not is_over
    distance, is_over = edge_distance(GAP, np.array([0.47, 0.0, 0.0]))
    assert distance == pytest.approx(-0.020, abs=0.0015) and is_over
    assert support(GAP, np.array([0.3, 0.0, 0.0]), (0.04, 0.04)) == 1.0
    assert support(GAP, np.array([0.45, 0.0, 0.0]), (0.04, 0.04)) == pytest.approx(0.5, abs=0.1)


@needs_go2
@pytest.mark.sim
@pytest.mark.heavy
@pytest.mark.robots
def test_who_knows_the_ground_crosses_and_who_is_blind_does_not() -> None:
    """Over trenches of 60 mm; the blind robot is told as what it is: fallen, stopped, or badly supported."""
    done = cross("trenches", 1, "all_knowing")
    assert (done.result, done.targets_over_gap, done.soles_badly_supported) == ("crossed", 0, 0)
    assert done.worst_edge_m > 0.02 and done.way_m > 1.4
    blind = cross("trenches", 1, "blind")
    assert blind.result != "crossed" or blind.soles_badly_supported
    assert {leg for leg, *_ in blind.trace} <= set(LEGS)


# Kind and seed of walks by the laser that cross.
BY_LASER = (
    ("trenches", 1),
    ("trenches", 6),
    ("stones", 1),
    ("stones", 2),
    ("stones", 6),
    ("mixed", 1),
    ("mixed", 6),
    ("rubble", 0),
    ("rubble", 1),
    ("stairs", 0),
)


@needs_go2
@pytest.mark.sim
@pytest.mark.heavy
@pytest.mark.robots
@pytest.mark.parametrize(("kind", "seed"), BY_LASER)
def test_with_the_laser_no_foot_is_sent_over_a_gap(kind: str, seed: int) -> None:
    """The robot crosses, and no target was over a gap or nearer to an edge than 20 mm."""
    done = cross(kind, seed, "laser")
    assert (done.result, done.targets_over_gap, done.soles_badly_supported) == ("crossed", 0, 0), done
    assert done.worst_edge_m > 0.02


@pytest.mark.skipif(find_spec("mujoco") is None, reason="MuJoCo is not installed (sim)")
@pytest.mark.sim
@pytest.mark.heavy
def test_a_guara_crosses_on_flat_soles() -> None:
    """Over trenches of 40 mm it sets down each sole within 5 mm of its target."""
    off = []

    def add(done: Crossing, robot: Robot, sight: Sight) -> None:
        leg, *target = done.trace[-1][:3]
        off.append(np.hypot(*(robot.feet[LEGS.index(leg)][:2] - target)))

    done = cross("trenches", 3, "all_knowing", add, robot="guara")
    assert (done.result, done.targets_over_gap, done.soles_badly_supported) == ("crossed", 0, 0), done
    assert max(off) < 0.005


@pytest.mark.skipif(find_spec("mujoco") is None, reason="MuJoCo is not installed (sim)")
@pytest.mark.sim
@pytest.mark.heavy
@pytest.mark.parametrize(("kind", "seed"), [("rubble", 1), ("mixed", 0)])
def test_a_guara_walks_around_what_the_laser_bars(kind: str, seed: int) -> None:
    """Margins around blocks take the lanes of its feet; on the second course a straight knee once made it fall."""
    done = cross(kind, seed, "laser", robot="guara")
    assert (done.result, done.targets_over_gap, done.soles_badly_supported) == ("crossed", 0, 0), done
    assert done.worst_edge_m > 0.05


@needs_go2
@pytest.mark.sim
@pytest.mark.heavy
@pytest.mark.robots
def test_odometry_of_feet_that_roll_keeps_its_height() -> None:
    """Read without errors over 1.6 m of level ground, legs alone: 5 mm in height, 1 % of the way along it."""
    odometry, errors = LegOdometry(go2()), []

    def add(done: Crossing, robot: Robot, sight: Sight) -> None:
        joints = dict(zip(robot.joint_names, robot.joint_positions.tolist(), strict=True))
        pose = odometry.update(Stance(joints, robot.product.legs, tuple(-robot.rotation[2])))
        errors.append(robot.base - pose.transform_base_to_odom[:3, 3])

    assert cross("flat", 0, "all_knowing", add).way_m > 1.6
    x, _, z = np.abs(np.array(errors) - errors[0]).max(axis=0)
    assert z < 0.005 and x < 0.016
