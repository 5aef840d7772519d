import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinematics import RobotModel, load_robot
from tests.thorough import examples

ROBOTS = {"guara": load_robot("guara")}


def some_positions(robot: RobotModel, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(robot.tree.lower_limits, robot.tree.upper_limits)


def test_jacobian_agrees_with_finite_differences(robot: RobotModel) -> None:
    """Columns of a frame's Jacobian are the derivatives of its origin and attitude with respect to each joint."""
    positions, increment = some_positions(robot, 1), 1e-6
    frame = robot.config.legs[1].sole
    jacobian = robot.state(positions).jacobian(frame)
    here = robot.state(positions).transform_to_base(frame)
    for column in range(len(positions)):
        moved = positions.copy()
        moved[column] += increment
        there = robot.state(moved).transform_to_base(frame)
        np.testing.assert_allclose((there - here)[:3, 3] / increment, jacobian[:3, column], atol=1e-5)
        turned = (there[:3, :3] - here[:3, :3]) @ here[:3, :3].T / increment
        np.testing.assert_allclose([turned[2, 1], turned[0, 2], turned[1, 0]], jacobian[3:, column], atol=1e-5)


def test_other_legs_do_not_move_a_sole(robot: RobotModel) -> None:
    """A sole's Jacobian is zero for the joints of all other legs."""
    first, second = robot.config.legs[:2]
    jacobian = robot.state(some_positions(robot, 2)).jacobian(first.sole)
    columns = [robot.tree.joint_index(joint) for joint in second.joints]
    assert np.all(jacobian[:, columns] == 0.0)


def test_centre_of_mass_is_the_weighted_mean_of_links(robot: RobotModel) -> None:
    """Pinocchio's centre of mass equals the mass-weighted mean of the links."""
    state = robot.state(some_positions(robot, 3))
    total, weighted_sum = 0.0, np.zeros(3)
    for name, link in robot.tree.links.items():
        if link.mass is not None:
            transform = state.transform_to_base(name)
            weighted_sum += link.mass * (transform[:3, :3] @ link.centre_of_mass + transform[:3, 3])
            total += link.mass
    np.testing.assert_allclose(state.centre_of_mass_in_base, weighted_sum / total, atol=1e-12)


def test_frames_are_the_products_of_the_joints(robot: RobotModel) -> None:
    """Every frame equals the product of the joint transforms of the URDF."""
    state = robot.state(some_positions(robot, 4))
    above = {joint.child: joint for joint in robot.tree.urdf.joints}

    def pose(link: str) -> np.ndarray:
        if link not in above:
            return np.eye(4)
        joint, turn = above[link], np.eye(4)
        if joint.kind == "revolute":
            angle, (x, y, z) = state.joint_positions[joint.name], joint.axis
            cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
            turn[:3, :3] += np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
        return pose(joint.parent) @ joint.transform_child_to_parent @ turn

    for frame in robot.tree.links:
        np.testing.assert_allclose(state.transform_to_base(frame), pose(frame), atol=1e-12)


def test_everything_is_read_only(robot: RobotModel) -> None:
    """No array returned by a state can be written."""
    state = robot.state(robot.posture("scan"))
    frame = robot.config.camera_frame
    for array in (
        state.positions,
        state.transform_to_base(frame),
        state.position_in_base(frame),
        state.soles_in_base(),
        state.jacobian(frame),
        state.centre_of_mass_in_base,
    ):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0
    with pytest.raises(TypeError):
        state.joint_positions[robot.joint_names[0]] = 1.0  # type: ignore[index]


def test_states_do_not_share_memory(robot: RobotModel) -> None:
    """A later state does not change an earlier one."""
    first = robot.state(robot.posture("scan"))
    before = first.soles_in_base().copy()
    robot.state(some_positions(robot, 5))
    np.testing.assert_array_equal(first.soles_in_base(), before)


@settings(max_examples=examples(40), derandomize=True, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_mirrored_joints_give_mirrored_soles(seed: int) -> None:
    """Exchanging left and right joints (with reversed rolls) mirrors the soles."""
    robot = ROBOTS["guara"]
    positions = dict(zip(robot.joint_names, some_positions(robot, seed), strict=True))
    twin = {"l": "r", "r": "l"}
    mirrored = {twin[name[0]] + name[1:]: -value if "haa" in name else value for name, value in positions.items()}
    soles, image = robot.state(positions), robot.state(mirrored)
    for leg in robot.legs:
        np.testing.assert_allclose(
            image.soles_in_base([twin[leg[0]] + leg[1:]])[0],
            soles.soles_in_base([leg])[0] * (1.0, -1.0, 1.0),
            atol=1e-12,
        )
