import math
from pathlib import Path

import pytest

from kinematics import (
    ArgumentError,
    JointPositionError,
    PauseDetector,
    RobotModel,
    UnknownName,
    load_robot,
)
from testbed.altered_robot import altered_guara


def still(robot: RobotModel, speed: float = 0.0) -> dict[str, float]:
    return dict.fromkeys(robot.joint_names, speed)


def test_a_pause_is_long_enough_stillness(robot: RobotModel) -> None:
    """A pause begins after the joints were slow for the hold time; a fast joint, in either direction, ends it."""
    detector, limits = PauseDetector(robot), robot.pause_limits
    assert not detector.update(0.0, still(robot), robot.legs).is_pause
    report = detector.update(limits.hold_time / 2, still(robot), robot.legs)
    assert not report.is_pause and "s are needed" in report.reason and report.still_for == limits.hold_time / 2
    report = detector.update(limits.hold_time + 0.001, still(robot, 0.9 * limits.joint_speed_limit), robot.legs)
    assert report.is_pause and report.reason == ""
    fast = {**still(robot), robot.joint_names[2]: -0.2}
    report = detector.update(1.0, fast, robot.legs)
    assert not report.is_pause
    assert report.reason == f"joint {robot.joint_names[2]} moves at 0.200 rad/s, limit 0.05"
    assert not detector.update(1.1, still(robot), robot.legs).is_pause
    assert detector.update(1.1 + 1.01 * limits.hold_time, still(robot), robot.legs).is_pause


def test_a_prismatic_joint_is_judged_in_metres(tmp_path: Path) -> None:
    """0.02 m/s moves a foot like 0.1 rad/s of a leg of 0.2 m, which is above the limit of 0.05 rad/s."""
    folder = altered_guara(tmp_path)
    urdf, srdf = folder / "urdf" / "guara.urdf", folder / "srdf" / "guara.srdf"
    slide = '<joint name="imu_joint" type="prismatic"><axis xyz="1 0 0"/><limit lower="-1" upper="1" velocity="1"/>'
    urdf.write_text(urdf.read_text().replace('<joint name="imu_joint" type="fixed">', slide))
    states = srdf.read_text().replace("</group_state>", '<joint name="imu_joint" value="0"/></group_state>')
    srdf.write_text(states)
    robot = load_robot(folder)
    detector = PauseDetector(robot)
    detector.update(0.0, still(robot), robot.legs)
    assert detector.update(1.0, {**still(robot), "imu_joint": 0.009}, robot.legs).is_pause
    report = detector.update(2.0, {**still(robot, 0.03), "imu_joint": -0.02}, robot.legs)
    assert not report.is_pause and report.reason == "joint imu_joint moves at 0.020 m/s, limit 0.01"


def test_a_change_of_feet_starts_again(robot: RobotModel) -> None:
    """A change of the supporting feet restarts the hold time; their order does not matter."""
    detector = PauseDetector(robot)
    detector.update(0.0, still(robot), robot.legs)
    assert detector.update(1.0, still(robot), tuple(reversed(robot.legs))).is_pause
    assert not detector.update(1.1, still(robot), robot.legs[:3]).is_pause
    assert detector.update(2.0, still(robot), robot.legs[:3]).is_pause


def test_two_feet_are_no_pause(robot: RobotModel) -> None:
    """With fewer feet than a support plane needs, there is no pause, and the reason names the number."""
    detector = PauseDetector(robot)
    detector.update(0.0, still(robot), robot.legs[:2])
    report = detector.update(5.0, still(robot), robot.legs[:2])
    assert not report.is_pause and report.reason == "2 feet carry the body, 3 are needed"


def test_bad_readings_are_refused(robot: RobotModel) -> None:
    """Times that do not increase, unknown or missing joints, NaN and unknown feet are rejected."""
    detector = PauseDetector(robot)
    detector.update(1.0, still(robot), robot.legs)
    with pytest.raises(ArgumentError, match="time is 1.0; it must be finite and later than the last reading"):
        detector.update(1.0, still(robot), robot.legs)
    with pytest.raises(UnknownName, match="unknown joint 'x'"):
        detector.update(2.0, {**still(robot), "x": 0.0}, robot.legs)
    with pytest.raises(JointPositionError, match=f"no velocity for {robot.joint_names[0]}"):
        detector.update(2.0, {k: v for k, v in still(robot).items() if k != robot.joint_names[0]}, robot.legs)
    with pytest.raises(JointPositionError, match="velocity nan is not finite"):
        detector.update(2.0, {**still(robot), robot.joint_names[0]: math.nan}, robot.legs)
    with pytest.raises(UnknownName, match="unknown leg 'xx'"):
        detector.update(2.0, still(robot), ("xx",))
