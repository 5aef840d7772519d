import math

import numpy as np
import pytest

from kinematics import (
    ArgumentError,
    CameraMoved,
    JointPositionError,
    PauseDetector,
    RobotModel,
    Stance,
    StanceError,
    UnknownName,
    camera_motion,
    check_camera_still,
)
from kinematics.urdf import rotation_from_rpy


def still(robot: RobotModel, speed: float = 0.0) -> dict[str, float]:
    return dict.fromkeys(robot.joint_names, speed)


def test_a_pause_is_long_enough_stillness(robot: RobotModel) -> None:
    """When the joints were slow for the hold time it is a pause; a joint that turns backwards fast ends it."""
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


def test_a_change_of_feet_starts_again(robot: RobotModel) -> None:
    """When the set of loaded feet changes, the hold time runs from there; their order does not matter."""
    detector = PauseDetector(robot)
    detector.update(0.0, still(robot), robot.legs)
    assert detector.update(1.0, still(robot), tuple(reversed(robot.legs))).is_pause
    assert not detector.update(1.1, still(robot), robot.legs[:3]).is_pause
    assert detector.update(2.0, still(robot), robot.legs[:3]).is_pause


def test_two_feet_are_no_pause(robot: RobotModel) -> None:
    """With fewer feet than a support plane needs there is no pause, and the reason says so."""
    detector = PauseDetector(robot)
    detector.update(0.0, still(robot), robot.legs[:2])
    report = detector.update(5.0, still(robot), robot.legs[:2])
    assert not report.is_pause and report.reason == "2 feet carry the body, 3 are needed"


def test_bad_readings_are_refused(robot: RobotModel) -> None:
    """Time that stands still, unknown or missing joints, NaN and unknown feet are refused."""
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


def shifted(robot: RobotModel, rotation: np.ndarray, shift: tuple[float, float, float]) -> Stance:
    """The scan posture after the body turned by a rotation and moved by a shift over feet that stayed."""
    joints = robot.posture("scan")
    soles = robot.state(joints).soles_in_base()
    for leg, sole in zip(robot.legs, soles, strict=True):
        names = robot.tree.leg(leg).joints
        found = robot.reach(leg, rotation.T @ (sole - shift))
        joints.update(zip(names, found.joint_positions.tolist(), strict=True))
    return Stance(joints, robot.legs)


def test_the_motion_of_the_camera_is_found(robot: RobotModel) -> None:
    """A known motion of the body over its feet gives the camera's distance and angle."""
    begin = Stance(robot.posture("scan"), robot.legs)
    rotation, shift = rotation_from_rpy(0.0, 0.002, 0.001), (0.0004, 0.0, -0.0003)
    motion = camera_motion(robot, begin, shifted(robot, rotation, shift))
    camera = robot.transform_camera_to_base[:3, 3]
    assert motion.translation == pytest.approx(np.linalg.norm(rotation @ camera + shift - camera), abs=1e-7)
    assert motion.rotation == pytest.approx(math.hypot(0.002, 0.001), rel=1e-3)


def test_a_scan_during_which_the_camera_moved_is_refused(robot: RobotModel) -> None:
    """A scan is refused at 0.6 mm or 0.06 degrees, not at 0.4 mm and 0.02; the message gives both with their limits."""
    begin = Stance(robot.posture("scan"), robot.legs)
    unrotated = np.eye(3)
    assert check_camera_still(robot, begin, begin).translation == pytest.approx(0.0, abs=1e-12)
    assert check_camera_still(robot, begin, shifted(robot, unrotated, (0.0, 0.0004, 0.0))).is_still
    with pytest.raises(CameraMoved, match=r"moved by 0.60 mm and 0.000 degrees .* 0.5 mm and 0.05 degrees are allowed"):
        check_camera_still(robot, begin, shifted(robot, unrotated, (0.0, 0.0006, 0.0)))
    # A turn about the camera itself, so that it turns without moving.
    for angle, allowed in ((0.02, True), (0.06, False)):
        rotation = rotation_from_rpy(0.0, 0.0, math.radians(angle))
        camera = robot.transform_camera_to_base[:3, 3]
        motion = camera_motion(robot, begin, shifted(robot, rotation, tuple(camera - rotation @ camera)))
        assert motion.is_still is allowed
        assert math.degrees(motion.rotation) == pytest.approx(angle, rel=1e-4)


def test_the_calibrated_camera_counts(robot: RobotModel) -> None:
    """The farther out a camera is, the more a turn moves it."""
    begin, turned = Stance(robot.posture("scan"), robot.legs), rotation_from_rpy(0.0, 0.001, 0.0)
    far = robot.transform_camera_to_base.copy()
    far[0, 3] += 1.0
    end = shifted(robot, turned, (0.0, 0.0, 0.0))
    near = camera_motion(robot, begin, end).translation
    assert camera_motion(robot, begin, end, transform_camera_to_base=far).translation > near + 0.0009


def test_three_feet_must_have_stayed(robot: RobotModel) -> None:
    """With fewer than three common feet the motion is unknown, and the question is refused."""
    joints = robot.posture("scan")
    with pytest.raises(StanceError, match="support_feet: 2 feet carried the body before and after"):
        camera_motion(robot, Stance(joints, robot.legs), Stance(joints, robot.legs[:2]))
