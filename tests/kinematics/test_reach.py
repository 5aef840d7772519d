import numpy as np
import pytest

from kinematics import ArgumentError, RobotModel, Stance, UnknownName, reach_from_pose
from kinematics.urdf import rotation_from_rpy


def test_reach_at_scan_height(guara: RobotModel) -> None:
    """On level ground, a foot reaches 150 mm to the front and rear of its hip and 174 mm sideways, not farther."""
    hip = np.array([0.300, 0.180, 0.0])
    for direction, reach in (((1, 0), 0.150), ((-1, 0), 0.150), ((0, 1), 0.174)):
        near = hip + (direction[0] * (reach - 0.001), direction[1] * (reach - 0.001), -0.360)
        far = hip + (direction[0] * (reach + 0.003), direction[1] * (reach + 0.003), -0.360)
        assert guara.reachable("lf", near) and not guara.reachable("lf", far)


def test_grids_keep_their_shape(robot: RobotModel) -> None:
    """Arrays of soles of any shape give results of that shape; the current soles are always reachable."""
    state = robot.state(robot.posture("scan"))
    sole = state.soles_in_base([robot.legs[0]])[0]
    grid = np.tile(sole, (3, 4, 1))
    grid[0, 0] = np.nan
    reach = robot.reach(robot.legs[0], grid)
    joints = len(robot.config.legs[0].joints)
    assert reach.joint_positions.shape == (3, 4, joints) and reach.is_reachable.shape == (3, 4)
    assert not reach.is_reachable[0, 0] and reach.is_reachable.sum() == 11
    assert not reach.joint_positions.flags.writeable and not reach.is_reachable.flags.writeable


def test_no_soles_have_no_answers(robot: RobotModel) -> None:
    """Empty arrays give empty results."""
    reach = robot.reach(robot.legs[0], np.empty((0, 3)))
    joints = len(robot.config.legs[0].joints)
    assert reach.joint_positions.shape == (0, joints) and reach.is_reachable.shape == (0,)


def test_joint_limits_bound_the_reach(robot: RobotModel) -> None:
    """Every reachable solution is within the joint limits."""
    x, y = np.meshgrid(np.linspace(-0.2, 0.6, 15), np.linspace(-0.2, 0.5, 15))
    leg = robot.config.legs[0]
    floor = robot.state(robot.posture("scan")).soles_in_base()[0, 2]
    reach = robot.reach(leg.name, np.stack([x, y, np.full_like(x, floor)], axis=-1))
    columns = [robot.tree.joint_index(joint) for joint in leg.joints]
    found = reach.joint_positions[reach.is_reachable]
    assert 0 < len(found) < x.size
    assert np.all(found >= robot.tree.lower_limits[columns] - 1e-9)
    assert np.all(found <= robot.tree.upper_limits[columns] + 1e-9)


@pytest.mark.parametrize(("roll", "pitch"), [(0.0, 0.0), (0.04, 0.05), (-0.08, -0.06)])
def test_soles_from_a_tilted_body_lie_level(guara: RobotModel, roll: float, pitch: float) -> None:
    """Soles of a tilted body are placed on the ground as requested, with a horizontal x axis."""
    gravity = rotation_from_rpy(roll, pitch, 0.0).T @ (0.0, 0.0, -1.0)
    pose = guara.stance_pose(Stance(guara.posture("scan"), guara.legs, tuple(gravity.tolist())), find_unloaded=False)
    for leg in guara.legs:
        hip = pose.transform_base_to_footprint[:3, :3] @ pose.state.position_in_base(guara.tree.leg(leg).hip)
        target = np.array([hip[0] + 0.03, hip[1], 0.0])
        reach = reach_from_pose(pose, leg, target)
        assert reach.is_reachable
        joints = guara.posture("scan") | dict(
            zip(guara.tree.leg(leg).joints, reach.joint_positions.tolist(), strict=True)
        )
        sole = pose.transform_base_to_footprint @ guara.state(joints).transform_to_base(guara.tree.leg(leg).sole)
        np.testing.assert_allclose(sole[:3, 3], target, atol=1e-12)
        assert sole[2, 0] == pytest.approx(0.0, abs=1e-12)


def test_recorded_soles_are_reachable_where_they_are(guara: RobotModel) -> None:
    """For a level stance, the positions of the soles give the joints of the posture."""
    pose = guara.stance_pose(Stance(guara.posture("scan"), guara.legs))
    for leg, sole in zip(pose.support_feet_used, pose.soles_in_footprint, strict=True):
        reach = reach_from_pose(pose, leg, sole)
        expected = [guara.posture("scan")[joint] for joint in guara.tree.leg(leg).joints]
        np.testing.assert_allclose(reach.joint_positions, expected, atol=1e-9)


def test_bad_arguments_are_refused(robot: RobotModel) -> None:
    """Unknown legs and wrong shapes are rejected by name."""
    pose = robot.stance_pose(Stance(robot.posture("scan"), robot.legs))
    with pytest.raises(UnknownName, match="unknown leg 'xx'"):
        robot.reachable("xx", [0.0, 0.0, 0.0])
    with pytest.raises(ArgumentError, match=r"soles_in_base has shape \(2,\); \(\.\.\., 3\) is needed"):
        robot.reachable(robot.legs[0], [0.0, 0.0])
    with pytest.raises(ArgumentError, match=r"sole_pitch has shape \(3,\); one number or \(2,\) is needed"):
        robot.reach(robot.legs[0], np.zeros((2, 3)), np.zeros(3))
    with pytest.raises(ArgumentError, match=r"soles_in_footprint has shape \(2,\)"):
        reach_from_pose(pose, robot.legs[0], [0.0, 0.0])
    with pytest.raises(ArgumentError, match=r"transforms_base_to_ground has shape \(3,\); \(\.\.\., 4, 4\) is needed"):
        robot.reach_from(robot.legs[0], np.zeros(3), np.zeros(3))
    with pytest.raises(ArgumentError, match=r"soles and .* have shapes \(2, 3\) and \(3, 4, 4\); they must broadcast"):
        robot.reach_from(robot.legs[0], np.zeros((2, 3)), np.zeros((3, 4, 4)))


def test_a_body_that_shifts_reaches_the_same_places_less_its_shift(robot: RobotModel) -> None:
    """Displaced and tilted bodies agree with `reach_from_pose`; a standing sole gives its own joint positions."""
    rotation = rotation_from_rpy(0.04, -0.05, 0.0)
    gravity = rotation.T @ (0.0, 0.0, -1.0)
    pose = robot.stance_pose(Stance(robot.posture("scan"), robot.legs, tuple(gravity.tolist())), find_unloaded=False)
    leg, shift = robot.legs[0], np.array([0.03, -0.02, -0.01])
    bodies = np.array([pose.transform_base_to_footprint, pose.transform_base_to_footprint])
    bodies[1, :3, 3] += shift
    sole = pose.soles_in_footprint[0]
    soles = np.array([sole, sole + (0.02, 0.01, 0.0)])
    here, there = robot.reach_from(leg, soles, bodies[0]), robot.reach_from(leg, soles + shift, bodies[1])
    np.testing.assert_allclose(here.joint_positions, reach_from_pose(pose, leg, soles).joint_positions, atol=1e-6)
    np.testing.assert_allclose(there.joint_positions, here.joint_positions, atol=1e-6)
    both = robot.reach_from(leg, soles[0] + shift, bodies)
    assert both.is_reachable.shape == (2,)
    np.testing.assert_allclose(both.joint_positions[1], here.joint_positions[0], atol=1e-6)
