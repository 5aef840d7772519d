"""Wrong joint readings are found as far as closed chains of standing legs show them, without false alarms."""

from __future__ import annotations

import copy
import math
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from kinematics import JointCheck, RobotModel, Stance, load_robot
from testbed.altered_robot import telescopic_guara
from testbed.misread_joints import ERROR, alarms, ground_of, is_named, load, misread, walk
from tests.thorough import IS_THOROUGH, further

GUARA_TOLD = [f"{leg}_{joint}_joint" for leg in ("lf", "rf", "lh", "rh") for joint in ("hfe", "kfe")]
GO2_TOLD = ["FL_thigh_joint", "FR_thigh_joint", "RL_thigh_joint", "RR_thigh_joint"]


@pytest.fixture(scope="module", params=["guara", *further("go2")])
def walker(request: pytest.FixtureRequest) -> RobotModel:
    """Robot with flat soles, and one with round feet."""
    return load(request.param)


@pytest.fixture(autouse=True)
def beyond_limits() -> Iterator[None]:
    """Ignore warnings: a wrong joint reading may be beyond the joint limits."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


@pytest.mark.slow
def test_a_jump_is_told_at_the_next_pause(walker: RobotModel) -> None:
    """A jump by +-0.1 rad of any joint of a standing leg: that joint is named, with few others."""
    pauses = walk(walker, 8, 1, has_imu=True)
    check = JointCheck(walker)
    for pause in pauses[:-1]:
        assert check.update(pause.stance).faults == ()
    legs = [leg for leg in walker.legs if leg != pauses[-2].next_leg]
    for joint in (joint for leg in legs for joint in walker.tree.leg(leg).joints):
        for error in (ERROR, -ERROR):
            (fault,) = copy.copy(check).update(misread(pauses[-1].stance, joint, error)).faults
            assert fault.kind == "jump" and joint in fault.joints, fault
            assert f"joint {fault.joints[0]}" in str(fault) and "jumped by" in str(fault)
            if fault.joints[0] == joint:
                assert fault.error == pytest.approx(error, abs=0.05)
    assert check.update(pauses[-1].stance).faults == ()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("joint", "error", "step", "seed", "has_imu"),
    [("rh_haa_joint", -ERROR, 7, 101, True), ("rf_haa_joint", ERROR, 8, 102, False)],
)
def test_a_jump_is_judged_by_all_that_is_known(
    guara: RobotModel, joint: str, error: float, step: int, seed: int, has_imu: bool
) -> None:
    """Joint noise moves and turns the sole; the last pause alone is noisier than the whole stance of the foot."""
    check, pauses = JointCheck(guara), walk(guara, 9, seed, has_imu=has_imu)
    for pause in pauses[:step]:
        check.update(pause.stance)
    assert is_named(check.update(misread(pauses[step].stance, joint, error)).faults, joint, "jump")


def test_a_jump_leaves_what_the_other_legs_showed(guara: RobotModel) -> None:
    """A jump does not reset the window: wrong zeros of other joints are still reported."""
    check, pauses = JointCheck(guara), walk(guara, 5, 3, has_imu=True)
    for pause in pauses:
        check.update(pause.stance)
    known = check.bars["rf_hfe_joint"]
    (fault,) = check.update(misread(pauses[-1].stance, "lh_kfe_joint", ERROR)).faults
    assert fault.kind == "jump" and "lh_kfe_joint" in fault.joints
    assert check.bars["rf_hfe_joint"] < 1.1 * known


def test_one_pause_of_point_feet_leaves_no_degree_of_freedom(walker: RobotModel) -> None:
    """A pause of point feet has no degree of freedom; each flat sole adds one, an IMU two."""
    for has_imu in (False, True):
        check = JointCheck(walker)
        check.update(walk(walker, 1, 1, has_imu=has_imu)[0].stance)
        assert check._window.degrees == {"guara": 4, "go2": 0}[walker.name] + 2 * has_imu


@pytest.mark.slow
def test_a_wrong_zero_is_told_within_a_cycle(walker: RobotModel) -> None:
    """A zero error of 0.1 rad of an observable joint is reported within a cycle, and `sigmas` shows that it is."""
    pauses = walk(walker, 5, 3, has_imu=True)
    joints = GUARA_TOLD if walker.name == "guara" else GO2_TOLD
    for joint in joints if IS_THOROUGH else joints[:2]:
        check = JointCheck(walker)
        reports = [check.update(misread(pause.stance, joint, ERROR)) for pause in pauses]
        assert is_named(reports[-1].faults, joint, "offset"), joint
        assert check.sigmas[joint] < 0.027
    unseen = {name: sigma for name, sigma in check.sigmas.items() if "haa" in name or "hip" in name}
    assert min(unseen.values()) > 0.1


@pytest.mark.slow
def test_known_ground_shows_legs_that_do_not_fit_it(walker: RobotModel) -> None:
    """Without an IMU, a wrong knee warps the four soles; only differences of ground heights count."""
    joint = "rf_kfe_joint" if walker.name == "guara" else "FL_calf_joint"
    pauses = walk(walker, 5, 100, has_imu=False)
    ground = ground_of(pauses[0])
    assert set(ground) == set(walker.legs)
    higher = {leg: (height + 0.5, sigma) for leg, (height, sigma) in ground.items()}
    told = []
    for heights in ({}, ground, higher):
        check = JointCheck(walker)
        for pause in pauses:
            report = check.update(misread(pause.stance, joint, ERROR), heights if pause.step == 0 else None)
        told.append((is_named(report.faults, joint, "offset"), check.sigmas[joint]))
    (without, alone), (within, sigma), (raised, same) = told
    assert (without, within, raised) == (False, True, True)
    assert sigma < 0.8 * alone and same == pytest.approx(sigma, rel=1e-3)


@pytest.mark.slow
def test_a_zero_that_explains_it_as_well_is_named_too(guara: RobotModel) -> None:
    """If an ankle is wrong and the better observable knee explains the readings as well, both are named."""
    check = JointCheck(guara)
    for pause in walk(guara, 5, 104, has_imu=True):
        faults = check.update(misread(pause.stance, "rh_afe_joint", -ERROR)).faults
    assert faults[0].joints == ("rh_kfe_joint", "rh_afe_joint")
    assert check.bars["rh_kfe_joint"] < ERROR < check.bars["rh_haa_joint"] == math.inf


@pytest.mark.slow
@pytest.mark.parametrize("has_imu", [True, *further(False)])
def test_clean_walks_raise_no_alarm(walker: RobotModel, has_imu: bool) -> None:
    """No alarm with fresh joint noise at every pause, soles set down off their target, and creeping feet."""
    assert alarms(walker, walk(walker, 500 if IS_THOROUGH else 60, 7, has_imu=has_imu)) == 0


def test_a_joint_beyond_its_limits_is_told(guara: RobotModel) -> None:
    """A joint beyond its limits is reported at the first pause too, without anything to compare with."""
    stance = Stance(guara.posture("scan"), guara.legs)
    report = JointCheck(guara).update(misread(stance, "lf_kfe_joint", -2.3))
    assert math.isnan(report.residual)
    (fault,) = report.faults
    assert str(fault).startswith("joint lf_kfe_joint is ") and "rad beyond its limits" in str(fault)


def test_a_robot_that_stands_is_compared_with_itself(guara: RobotModel) -> None:
    """An unchanged stance has no residual; a jump is reported at five pauses in a row, and `reset` forgets it."""
    stance = Stance(guara.posture("scan"), guara.legs, (0.0, 0.0, -1.0))
    check = JointCheck(guara)
    check.update(stance)
    assert check.update(stance).residual == pytest.approx(0.0, abs=1e-6)
    wrong = misread(stance, "rh_kfe_joint", ERROR)
    (fault,) = check.update(wrong).faults
    assert fault.joints == ("rh_kfe_joint",)
    assert [len(check.update(wrong).faults) for _ in range(5)] == [1, 1, 1, 1, 0]
    check.reset()
    assert check.update(stance).faults == () and math.isinf(check.sigmas["lf_haa_joint"])


def test_a_foot_that_was_lifted_is_no_joint(guara: RobotModel) -> None:
    """Steps of 60 to 140 mm forward and sideways on level ground, one foot at a time, raise no alarm."""
    stance = Stance(guara.posture("scan"), guara.legs, (0.0, 0.0, -1.0))
    soles = guara.state(stance.joint_positions).soles_in_base(["lf"])[0]
    names = guara.tree.leg("lf").joints
    for x, y in ((0.06, 0.0), (0.10, 0.0), (0.14, 0.0), (-0.08, 0.0), (0.0, 0.06), (0.07, -0.05)):
        check = JointCheck(guara)
        check.update(stance)
        found = guara.reach("lf", soles + np.array([x, y, 0.0]), 0.0)
        joints = {**stance.joint_positions, **dict(zip(names, found.joint_positions.tolist(), strict=True))}
        report = check.update(Stance(joints, stance.support_feet, stance.gravity_in_base))
        assert report.faults == () and report.residual < 1.0, (x, y)


@pytest.mark.parametrize("feet", [("lf", "rf"), ("lf", "rf", "lh")])
def test_few_feet_tell_nothing_of_others(guara: RobotModel, feet: tuple[str, ...]) -> None:
    """With two feet nothing is compared; with three, the joints of the fourth leg are not."""
    stance = Stance(guara.posture("scan"), feet, (0.0, 0.0, -1.0))
    check = JointCheck(guara)
    check.update(stance)
    report = check.update(misread(stance, "rh_hfe_joint", ERROR))
    assert report.faults == () and math.isnan(report.residual) == (len(feet) < 3)


def test_prismatic_joints_are_judged_in_metres(tmp_path: Path) -> None:
    """Prismatic knee: a jump of 15 mm is reported, one of 4 mm is noise; sigmas and excess are in metres."""
    robot = load_robot(telescopic_guara(tmp_path))
    knee, still = "lf_kfe_joint", robot.posture("scan")

    def jumped(error: float) -> list[str]:
        check = JointCheck(robot)
        for joints in (still, {**still, knee: still[knee] + error}):
            report = check.update(Stance(joints, robot.legs, (0.0, 0.0, -1.0)))
        return [str(fault) for fault in report.faults]

    assert jumped(0.004) == []
    (told,) = jumped(0.015)
    assert told.startswith(f"joint {knee} jumped by +0.015 m (sigma 0.002) between two pauses")
    assert jumped(0.09) == [f"joint {knee} is 0.030 m beyond its limits: check its encoder"]
    pose = robot.stance_pose(Stance(still, robot.legs))
    # Four feet on prismatic legs with noise of 0.7 mm and contact noise of 1 mm.
    assert 0.0003 < math.sqrt(pose.covariance[2, 2]) < 0.001
