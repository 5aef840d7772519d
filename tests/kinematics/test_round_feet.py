"""Round feet that roll as the body advances: positions of their soles, and odometry."""

from __future__ import annotations

import re
import shutil

import numpy as np
import pytest
from scipy.optimize import least_squares

from kinematics import LegOdometry, RobotModel, Stance, load_robot
from kinematics.arrays import Float
from tests.kinematics.conftest import SECOND_ROBOT

RADIUS = 0.023
ADVANCE, HEIGHT, CYCLES = 0.035, 0.320, 6


@pytest.fixture(scope="module")
def round_footed(tmp_path_factory: pytest.TempPathFactory) -> RobotModel:
    """Robot tapir with balls of 23 mm above its sole frames, which are level in its scan posture."""
    folder = tmp_path_factory.mktemp("robots") / "tapir"
    shutil.copytree(SECOND_ROBOT, folder)
    text = (
        (folder / "robot.toml")
        .read_text()
        .replace("\nsole = [0.030, 0.030]", f"\nsole_radius = {RADIUS}\nsole = [0.015, 0.015]")
    )
    (folder / "robot.toml").write_text(text)
    urdf = folder / "urdf" / "tapir.urdf"
    level = r'\1 rpy="0 0.643501 0"/>'
    text, count = re.subn(r'(_tip_mount" type="fixed">\s*<origin xyz="0 0 -0.2")/>', level, urdf.read_text())
    assert count == 4
    urdf.write_text(text)
    return load_robot(folder)


def ball(robot: RobotModel, leg: str, joints: Float) -> tuple[Float, float]:
    """Centre of the ball of a foot in `base_link`, and rotation of the foot about y [rad]."""
    names = robot.tree.leg(leg).joints
    state = robot.state({**robot.posture("scan"), **dict(zip(names, joints.tolist(), strict=True))})
    place = state.transform_to_base(robot.tree.leg(leg).sole)
    return place[:3, 3] + RADIUS * place[:3, 2], float(np.arctan2(place[0, 2], place[2, 2]))


def test_the_sole_of_a_ball_is_its_lowest_point(round_footed: RobotModel) -> None:
    """For any bend of the leg, and consistently with inverse kinematics."""
    scan = round_footed.posture("scan")
    for seed in range(5):
        bend = dict(zip(scan, 0.3 * np.random.default_rng(seed).uniform(-1, 1, len(scan)), strict=True))
        state = round_footed.state({name: value + bend[name] for name, value in scan.items()})
        for leg, sole in zip(round_footed.legs, state.soles_in_base(), strict=True):
            centre, _ = ball(
                round_footed,
                leg,
                state.positions[[round_footed.tree.joint_index(n) for n in round_footed.tree.leg(leg).joints]],
            )
            assert sole[2] == pytest.approx(centre[2] - RADIUS, abs=1e-9)
            reached = round_footed.reach(leg, sole)
            again, _ = ball(round_footed, leg, reached.joint_positions)
            assert reached.is_reachable
            np.testing.assert_allclose(again, centre, atol=1e-8)


def test_feet_that_roll_do_not_lift_the_walk(round_footed: RobotModel) -> None:
    """Centres of standing balls move by radius times rotation; height and path of the walk stay correct."""
    robot, odometry = round_footed, LegOdometry(round_footed)
    names = {leg: robot.tree.leg(leg).joints for leg in robot.legs}
    joints = {leg: np.array([robot.posture("scan")[n] for n in names[leg]]) for leg in robot.legs}
    # For each foot: x of the centre in the world when the foot is not rotated; y of the centre.
    stands = {}
    for leg in robot.legs:
        centre, turn = ball(robot, leg, joints[leg])
        stands[leg] = np.array([centre[0] - RADIUS * turn, centre[1]])

    def stance(body: float) -> Stance:
        for leg in robot.legs:

            def missed(angles: Float, leg: str = leg) -> Float:
                centre, turn = ball(robot, leg, angles)
                on_ground = (stands[leg][0] + RADIUS * turn - body, stands[leg][1], RADIUS - HEIGHT)
                return np.asarray(centre - on_ground)

            joints[leg] = least_squares(missed, joints[leg], xtol=1e-12, ftol=1e-12, gtol=1e-12).x
        angles = {n: float(a) for leg in robot.legs for n, a in zip(names[leg], joints[leg], strict=True)}
        return Stance(angles, robot.legs, (0.0, 0.0, -1.0))

    first = odometry.update(stance(0.0))
    for step in range(1, 4 * CYCLES + 1):
        stands[robot.legs[step % 4]][0] += 4 * ADVANCE
        last = odometry.update(stance(ADVANCE * step))
    moved = last.transform_base_to_odom[:3, 3] - first.transform_base_to_odom[:3, 3]
    assert moved == pytest.approx([ADVANCE * 4 * CYCLES, 0.0, 0.0], abs=0.003)
    assert abs(moved[2]) < 0.001
