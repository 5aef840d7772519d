"""Clearance of a sole and its leg above the ground at a foothold."""

import math

import numpy as np
import pytest

from kinematics import ArgumentError, RobotModel, Stance, StanceError, StancePose, UnknownName, foothold_clearance


def flat(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.zeros_like(x)


def foothold(pose: StancePose, leg: str) -> np.ndarray:
    return pose.soles_in_footprint[pose.support_feet_used.index(leg)]


def test_a_sole_on_flat_ground_touches_it_all_over(robot: RobotModel, standing: StancePose) -> None:
    """On flat ground, the whole sole touches the ground and the leg above it is clear."""
    for leg in robot.legs:
        clearance = foothold_clearance(standing, leg, foothold(standing, leg), flat)
        assert clearance.sole == pytest.approx(0.0, abs=1e-9)
        assert clearance.sole_gap == pytest.approx(0.0, abs=1e-9)
        assert clearance.leg > 0.005


def test_a_step_under_the_sole_presses_into_it(guara: RobotModel) -> None:
    """A step of 12 mm under the front of the sole gives -12 mm; a hole under the heel leaves a gap."""
    standing = guara.stance_pose(Stance(guara.posture("scan"), guara.legs))
    target = foothold(standing, "lf")
    step = foothold_clearance(standing, "lf", target, lambda x, y: np.where(x > target[0] + 0.03, 0.012, 0.0))
    assert step.sole == pytest.approx(-0.012) and step.sole_gap == pytest.approx(0.0, abs=1e-9)
    hole = foothold_clearance(standing, "lf", target, lambda x, y: np.where(x < target[0] - 0.03, -0.05, 0.0))
    assert hole.sole_gap == pytest.approx(0.05) and hole.sole == pytest.approx(0.0, abs=1e-9)


def test_a_wall_before_the_knee_leaves_no_clearance(robot: RobotModel, standing: StancePose) -> None:
    """The higher the wall, the smaller the leg's clearance, down to negative values; the sole touches flat ground."""
    leg = robot.legs[0]
    target = foothold(standing, leg)
    last = math.inf
    for height in (0.1, 0.2, 0.25):
        beyond = max(robot.sole) / 2.0 + 0.005
        wall = foothold_clearance(
            standing, leg, target, lambda x, y, h=height, b=beyond: np.where(abs(x - target[0]) > b, h, 0.0)
        )
        assert wall.leg < last and wall.sole == pytest.approx(0.0, abs=1e-9)
        last = wall.leg
    assert last < 0.0


def test_unknown_ground_is_not_clear(robot: RobotModel, standing: StancePose) -> None:
    """Unknown ground below leg or sole gives NaN, which satisfies no comparison."""
    target = foothold(standing, robot.legs[0])
    clearance = foothold_clearance(standing, robot.legs[0], target, lambda x, y: np.full_like(x, np.nan))
    assert math.isnan(clearance.leg) and math.isnan(clearance.sole) and math.isnan(clearance.sole_gap)
    hole = foothold_clearance(
        standing, robot.legs[0], target, lambda x, y: np.where(x > target[0] + max(robot.sole), np.nan, 0.0)
    )
    assert hole.sole == pytest.approx(0.0, abs=1e-9)


def test_joints_are_those_that_reach_the_foothold(robot: RobotModel, standing: StancePose) -> None:
    """Forward kinematics of the returned joint positions leads to the foothold."""
    leg = robot.legs[1]
    target = foothold(standing, leg) + (0.03, 0.0, 0.01)
    found = foothold_clearance(standing, leg, target, flat)
    joints = dict(standing.state.joint_positions)
    joints.update(zip(robot.tree.leg(leg).joints, found.joint_positions.tolist(), strict=True))
    sole = robot.state(joints).soles_in_base([leg])[0]
    np.testing.assert_allclose((standing.transform_base_to_footprint @ [*sole, 1.0])[:3], target, atol=1e-8)


def test_bad_arguments_are_refused(robot: RobotModel, standing: StancePose) -> None:
    """Footholds out of reach, wrong shapes and invalid results of the height function are rejected."""
    leg = robot.legs[0]
    target = foothold(standing, leg)
    with pytest.raises(StanceError, match=rf"leg '{leg}' does not reach the foothold \("):
        foothold_clearance(standing, leg, target + (1.0, 0.0, 0.0), flat)
    with pytest.raises(ArgumentError, match=r"sole_in_footprint is \[.*\]; allowed: 3 finite numbers"):
        foothold_clearance(standing, leg, target[:2], flat)
    with pytest.raises(ArgumentError, match=r"height_at returned shape \(\)"):
        foothold_clearance(standing, leg, target, lambda x, y: 0.0)
    with pytest.raises(UnknownName, match="unknown leg 'xx'"):
        foothold_clearance(standing, "xx", target, flat)
