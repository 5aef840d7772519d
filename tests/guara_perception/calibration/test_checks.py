"""Checks of a calibration: the mount by joint angles against gravity, and the uncertainty of floor points."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from guara_perception.calibration.checks import camera_checks, stance_checks
from guara_perception.calibration.quality import projection_uncertainty
from guara_perception.calibration.result import CalibrationResult
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
    """There is nothing to compare."""
    assert stance_checks(robot, standing(robot, None)) == []
    two = dataclasses.replace(standing(robot, (0.0, 0.0, -1.0)), support_feet=robot.legs[:2])
    assert stance_checks(robot, two) == []


def test_pixels_beyond_the_scanned_area_or_above_the_horizon_refuse_no_mount(result: CalibrationResult) -> None:
    """A camera tilted up by 60 degrees sees the horizon, where floor points are not determined."""
    up = cv2.Rodrigues(np.array([0.0, -np.deg2rad(60.0), 0.0]))[0]
    to_footprint = np.array(result.fit.transform_camera_to_footprint)
    to_footprint[:3, :3] = up @ to_footprint[:3, :3]
    to_camera = np.linalg.inv(to_footprint)
    pose = np.append(cv2.Rodrigues(to_camera[:3, :3])[0].ravel(), to_camera[:3, 3])
    fit = dataclasses.replace(result.fit, transform_camera_to_footprint=to_footprint, pose=pose)
    far = 1.5
    pixels, sigma = projection_uncertainty(fit, far)
    rays = fit.camera.rays(pixels) @ to_footprint[:3, :3].T
    depth = -to_footprint[2, 3] / rays[:, 2]
    sees_floor = (depth > 0) & (to_footprint[0, 3] + depth * rays[:, 0] <= far)
    assert 0 < sees_floor.sum() < len(pixels) and (depth < 0).any()
    np.testing.assert_array_equal(np.isfinite(sigma), sees_floor)
    everywhere = projection_uncertainty(fit, np.inf)[1]
    assert np.nanmax(sigma) < 3e-3 < np.nanmax(everywhere)


def test_a_camera_that_sees_no_scanned_floor_is_refused(result: CalibrationResult) -> None:
    """Without a pixel to judge there is no evidence that the mount is right."""
    nothing = np.full(63, np.nan)
    checks = camera_checks(result.intrinsics, result.fit, result.floor, None, result.coverage, None, nothing)
    assert next(check for check in checks if check.name == "floor point sigma").verdict == "refused"
