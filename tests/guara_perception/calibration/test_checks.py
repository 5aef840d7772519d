"""The mount by joint angles against the mount by gravity."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from guara_perception.calibration.checks import stance_checks
from kinematics import RobotModel, Stance


def standing(robot: RobotModel, gravity: tuple[float, float, float] | None) -> Stance:
    return Stance(robot.posture(robot.config.scan_posture), robot.legs, gravity)


@pytest.mark.slow
@given(tilt=st.floats(0.0, 40.0), heading=st.floats(-np.pi, np.pi))
def test_the_figure_is_the_angle_between_soles_and_gravity(robot: RobotModel, tilt: float, heading: float) -> None:
    """Whichever way the floor slopes; its limits are 0.5 and 2 degrees."""
    angle = np.deg2rad(tilt)
    gravity = (np.sin(angle) * np.cos(heading), np.sin(angle) * np.sin(heading), -np.cos(angle))
    (check,) = stance_checks(robot, standing(robot, tuple(map(float, gravity))))
    assert check.value == pytest.approx(tilt, abs=1e-6)
    if min(abs(tilt - 0.5), abs(tilt - 2.0)) > 1e-5:
        assert check.verdict == ("good" if tilt < 0.5 else "usable" if tilt < 2.0 else "refused")


def test_wrong_zeros_of_the_front_knees_show(robot: RobotModel) -> None:
    """Six degrees in both: the soles as computed slope although the floor is level."""
    stance = standing(robot, (0.0, 0.0, -1.0))
    joints = {
        name: position + np.deg2rad(6.0) * (name in ("lf_kfe_joint", "rf_kfe_joint"))
        for name, position in stance.joint_positions.items()
    }
    (right,) = stance_checks(robot, stance)
    (wrong,) = stance_checks(robot, dataclasses.replace(stance, joint_positions=joints))
    assert right.value < 1e-6 and right.verdict == "good"
    assert wrong.verdict != "good" and "the joints' zeros" in wrong.advice


def test_without_gravity_or_a_plane_of_soles_there_is_no_figure(robot: RobotModel) -> None:
    """Nothing to compare with."""
    assert stance_checks(robot, standing(robot, None)) == []
    two = dataclasses.replace(standing(robot, (0.0, 0.0, -1.0)), support_feet=robot.legs[:2])
    assert stance_checks(robot, two) == []
