import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kinematics import (
    ArgumentError,
    CameraMoved,
    RobotModel,
    Stance,
    StanceError,
    Stillness,
    camera_motion,
    check_camera_still,
    load_robot,
)
from kinematics.urdf import rotation_from_rpy
from testbed.altered_robot import telescopic_guara


def shifted(robot: RobotModel, rotation: np.ndarray, shift: tuple[float, float, float]) -> Stance:
    """Scan posture after the body was rotated and shifted over feet that stayed."""
    joints = robot.posture("scan")
    soles = robot.state(joints).soles_in_base()
    for leg, sole in zip(robot.legs, soles, strict=True):
        names = robot.tree.leg(leg).joints
        found = robot.reach(leg, rotation.T @ (sole - shift))
        joints.update(zip(names, found.joint_positions.tolist(), strict=True))
    return Stance(joints, robot.legs)


def test_the_motion_of_the_camera_is_found(robot: RobotModel) -> None:
    """A known motion of the body over its feet gives the camera's translation and rotation."""
    begin = Stance(robot.posture("scan"), robot.legs)
    rotation, shift = rotation_from_rpy(0.0, 0.002, 0.001), (0.0004, 0.0, -0.0003)
    motion = camera_motion(robot, begin, shifted(robot, rotation, shift))
    camera = robot.transform_camera_to_base[:3, 3]
    assert motion.translation == pytest.approx(np.linalg.norm(rotation @ camera + shift - camera), rel=0.01)
    assert motion.rotation == pytest.approx(math.hypot(0.002, 0.001), rel=0.01)


def test_a_scan_during_which_the_camera_moved_is_refused(robot: RobotModel) -> None:
    """Two exact readings show 1.5 mm or 0.15 degrees, with the limits; a motion within these limits is harmless."""
    begin = Stance(robot.posture("scan"), robot.legs)
    unrotated, camera = np.eye(3), robot.transform_camera_to_base[:3, 3]
    assert check_camera_still(robot, begin, begin).translation == pytest.approx(0.0, abs=1e-12)
    assert check_camera_still(robot, begin, shifted(robot, unrotated, (0.0, 0.0, 0.0004))).is_still
    with pytest.raises(
        CameraMoved, match=r"moved by 1.5\d mm and 0.0\d\d degrees .* 0.5 mm and 0.05 degrees are allowed"
    ):
        check_camera_still(robot, begin, shifted(robot, unrotated, (0.0, 0.0, 0.0015)))
    # A rotation about the camera itself, so that it does not translate.
    for angle, allowed in ((0.04, True), (0.15, False)):
        rotation = rotation_from_rpy(0.0, math.radians(angle), 0.0)
        motion = camera_motion(robot, begin, shifted(robot, rotation, tuple(camera - rotation @ camera)))
        assert motion.is_still is allowed
        assert math.degrees(motion.rotation) == pytest.approx(angle, rel=2e-2)


def test_the_calibrated_camera_counts(robot: RobotModel) -> None:
    """The farther the camera is from the axis, the more a rotation moves it."""
    begin, turned = Stance(robot.posture("scan"), robot.legs), rotation_from_rpy(0.0, 0.001, 0.0)
    far = robot.transform_camera_to_base.copy()
    far[0, 3] += 1.0
    end = shifted(robot, turned, (0.0, 0.0, 0.0))
    near = camera_motion(robot, begin, end).translation
    assert camera_motion(robot, begin, end, transform_camera_to_base=far).translation > near + 0.0009


def test_three_feet_must_have_stayed(robot: RobotModel) -> None:
    """With fewer than three common feet, the motion is unobservable, which is an error."""
    joints = robot.posture("scan")
    with pytest.raises(StanceError, match="support_feet: 2 carried the body in all readings"):
        camera_motion(robot, Stance(joints, robot.legs), Stance(joints, robot.legs[:2]))


Motion = Callable[[float], tuple[np.ndarray, np.ndarray]]


def paused(robot: RobotModel, times: np.ndarray, body: Motion, noise: float, rng: np.random.Generator) -> Stillness:
    """Pause of a body that moves as `body` returns (rotation and shift by time), with biased and noisy joints."""
    bias = rng.normal(0.0, robot.noise.encoder_sigma, len(robot.joint_names))
    found: Stillness | None = None
    for time in times:
        rotation, shift = body(float(time))
        exact = shifted(robot, rotation, tuple(shift)).joint_positions
        read = {
            joint: exact[joint] + b + rng.normal(0.0, noise) for joint, b in zip(robot.joint_names, bias, strict=True)
        }
        stance = Stance(read, robot.legs)
        if found is None:
            found = Stillness(robot, stance, float(time))
        else:
            found.add(float(time), stance)
    assert found is not None
    return found


def standing(time: float) -> tuple[np.ndarray, np.ndarray]:
    return np.eye(3), np.zeros(3)


WHITE = math.radians(0.05)
FREQUENT, BOTH_ENDS = np.arange(0.0, 1.01, 0.02), np.array([0.0, 1.0])


@pytest.mark.slow
@pytest.mark.parametrize(("times", "pauses"), [(FREQUENT, 20), (BOTH_ENDS, 300)], ids=["with HOLD", "without HOLD"])
def test_noise_alone_is_no_motion(robot: RobotModel, times: np.ndarray, pauses: int) -> None:
    """A standing robot raises no alarm: white noise of 0.05 degrees per reading, biases of 0.2 degrees."""
    rng, exact = np.random.default_rng(3), robot.posture("scan")
    for _ in range(pauses):
        bias = rng.normal(0.0, robot.noise.encoder_sigma, len(exact))
        readings = [
            Stance(
                dict(
                    zip(exact, np.array(list(exact.values())) + bias + rng.normal(0.0, WHITE, len(exact)), strict=True)
                ),
                robot.legs,
            )
            for _ in times
        ]
        stillness = Stillness(robot, readings[0], times[0])
        assert stillness.still_until == -math.inf
        for time, reading in zip(times[1:], readings[1:], strict=True):
            stillness.add(time, reading)
        assert stillness.motion == "" and stillness.still_until >= times[-1] - 0.1


@pytest.mark.slow
@pytest.mark.parametrize(
    ("times", "size", "shape"),
    [
        (FREQUENT, 1e-3, lambda time: float(time > 0.41)),
        (FREQUENT, 1e-3, lambda time: float(np.clip((time - 0.3) / 0.6, 0.0, 1.0))),
        (FREQUENT, 1e-3, lambda time: float(0.4 < time < 0.6)),
        (BOTH_ENDS, 1.5e-3, lambda time: float(time > 0.5)),
    ],
    ids=["step", "ramp", "pulse", "without HOLD"],
)
@pytest.mark.parametrize("kind", ["shift", "turn"])
def test_a_motion_shows_through_the_noise(
    robot: RobotModel, times: np.ndarray, size: float, shape: Callable[[float], float], kind: str
) -> None:
    """Motions of 1 mm or 0.1 degrees are detected, or 1.5 times as much without HOLD; earlier frames stay confirmed."""
    rng, camera = np.random.default_rng(5), robot.transform_camera_to_base[:3, 3]

    def body(time: float) -> tuple[np.ndarray, np.ndarray]:
        moved = size * shape(time)
        if kind == "shift":
            return np.eye(3), np.array([0.0, 0.0, moved])
        # 0.1 degrees for a millimetre.
        rotation = rotation_from_rpy(0.0, math.radians(100.0 * moved), 0.0)
        return rotation, camera - rotation @ camera

    stillness = paused(robot, times, body, WHITE, rng)
    assert "the camera moved by" in stillness.motion and "are allowed: scan again" in stillness.motion
    # The motion began after 0.3 s or later; frames until then stay confirmed, later ones do not.
    assert stillness.still_until < 0.62 if len(times) > 2 else stillness.still_until == -math.inf


def test_sway_does_not_count_as_noise(robot: RobotModel) -> None:
    """A sway of 2 mm at 3 Hz is detected at once and does not raise the estimated noise."""

    def sway(time: float) -> tuple[np.ndarray, np.ndarray]:
        return np.eye(3), np.array([0.0, 0.002 * math.sin(6.0 * math.pi * time), 0.0])

    still = paused(robot, FREQUENT, standing, WHITE, np.random.default_rng(1))
    swaying = paused(robot, FREQUENT, sway, WHITE, np.random.default_rng(1))
    assert swaying.motion and not still.motion
    assert np.trace(swaying.covariance) == pytest.approx(np.trace(still.covariance), rel=0.05)


def test_noise_that_hides_a_millimetre_is_told(robot: RobotModel, monkeypatch: pytest.MonkeyPatch) -> None:
    """Noise of 0.2 degrees stated in robot.toml is not a motion; the undetectable motion is reported."""
    with monkeypatch.context() as patch:
        patch.setattr(robot, "noise", replace(robot.noise, encoder_noise=math.radians(0.2)))
        noisy = paused(robot, FREQUENT, standing, math.radians(0.2), np.random.default_rng(2))
        assert noisy.undetectable.endswith("send HOLD more often")
    quiet = paused(robot, FREQUENT, standing, WHITE, np.random.default_rng(2))
    assert noisy.motion == ""
    assert np.trace(noisy.covariance) > 8.0 * np.trace(quiet.covariance)
    assert quiet.undetectable == ""
    alone = paused(robot, BOTH_ENDS, standing, WHITE, np.random.default_rng(2))
    assert alone.undetectable.startswith("joints too noisy") and alone.undetectable.endswith("send HOLD")
    assert np.trace(alone.covariance) > 5.0 * np.trace(quiet.covariance)


def test_a_repeated_reading_confirms_nothing(robot: RobotModel) -> None:
    """A repeated message, or one with an older stamp, does not extend the confirmed time."""
    begin = Stance(robot.posture("scan"), robot.legs)
    stillness = Stillness(robot, begin, 10.0)
    stillness.add(10.5, begin)
    assert stillness.still_until == 10.5
    stillness.add(10.5, begin)
    stillness.add(10.2, begin)
    assert stillness.still_until == 10.5
    with pytest.raises(ArgumentError, match="time is nan"):
        stillness.add(math.nan, begin)


def test_a_foot_that_is_lifted_leaves_the_others(robot: RobotModel) -> None:
    """With three of four feet left, the motion is still estimated; with two it is an error."""
    begin, moved = Stance(robot.posture("scan"), robot.legs), shifted(robot, np.eye(3), (0.0, 0.0, 0.003))
    stillness = Stillness(robot, begin, 0.0)
    stillness.add(1.0, Stance(moved.joint_positions, robot.legs[1:]))
    assert stillness.motion
    with pytest.raises(StanceError, match="2 carried the body"):
        stillness.add(2.0, Stance(moved.joint_positions, robot.legs[:3][1:]))


@pytest.mark.parametrize("times", [BOTH_ENDS, np.arange(0.0, 1.01, 0.2), FREQUENT], ids=["END", "5 Hz", "50 Hz"])
@pytest.mark.parametrize("stride", [0.01, 0.03, 0.06])
def test_feet_that_stepped_are_no_noise(robot: RobotModel, times: np.ndarray, stride: float) -> None:
    """Feet displaced at the end, as after steps, are reported although no motion of the body explains them."""
    rng = np.random.default_rng(6)
    exact = robot.posture("scan")
    state = robot.state(exact)
    for _ in range(20):
        moved = dict(exact)
        for leg, sole in zip(robot.legs, state.soles_in_base(), strict=True):
            away = rng.normal(size=3) * (1.0, 1.0, 0.0)
            found = robot.reach(leg, sole + stride * away / np.linalg.norm(away))
            moved.update(zip(robot.tree.leg(leg).joints, found.joint_positions.tolist(), strict=True))
        stillness = Stillness(robot, Stance(exact, robot.legs), 0.0)
        for time in times[1:]:
            read = {joint: (1 - time) * exact[joint] + time * moved[joint] + rng.normal(0.0, WHITE) for joint in exact}
            stillness.add(float(time), Stance(read, robot.legs))
        assert stillness.motion and stillness.still_until < 1.0


def test_a_long_pause_keeps_its_first_readings(robot: RobotModel) -> None:
    """A creep of 1 mm over thousands of readings is detected although the middle ones are dropped."""
    exact, moved = robot.posture("scan"), shifted(robot, np.eye(3), (0.0, 0.0, 0.001)).joint_positions
    rng, stillness = np.random.default_rng(4), Stillness(robot, Stance(exact, robot.legs), 0.0)
    for number in range(1, 3000):
        share = number / 3000
        read = {joint: (1 - share) * exact[joint] + share * moved[joint] + rng.normal(0.0, WHITE) for joint in exact}
        stillness.add(0.02 * number, Stance(read, robot.legs))
    assert stillness.motion


def test_legs_that_slide_are_as_noisy_as_legs_that_turn(tmp_path: Path) -> None:
    """A body that sinks by 1.5 mm on prismatic knees has moved; noise of 0.2 m times encoder_noise is no motion."""
    robot = load_robot(telescopic_guara(tmp_path))
    begin, noise = robot.posture("scan"), 0.2 * robot.noise.encoder_noise

    def moved(change: float) -> str:
        stillness = Stillness(robot, Stance(begin, robot.legs), 0.0)
        now = {name: value + change * ("kfe" in name) for name, value in begin.items()}
        stillness.add(1.0, Stance(now, robot.legs))
        return stillness.motion

    assert moved(2.0 * noise) == ""
    assert "the camera moved by 1.50 mm" in moved(0.0015)
