import numpy as np
import pytest

from kinematics import GravityEstimate, RobotModel, Stance
from kinematics.carried_gravity import carry_gravity, turn_between
from kinematics.urdf import rotation_from_rpy

SOLES = np.array([[0.3, 0.18, -0.36], [0.3, -0.18, -0.36], [-0.3, 0.18, -0.36], [-0.25, -0.18, -0.36]])
NOISE = np.tile(np.eye(3) * 1e-6, (4, 1, 1))


def test_a_known_turn_is_found() -> None:
    """The rotation between two point sets is recovered, also for coplanar points, which allow a reflection."""
    rotation = rotation_from_rpy(0.1, -0.2, 0.3)
    before = SOLES @ rotation.T + (0.1, 0.2, 0.3)
    np.testing.assert_allclose(turn_between(SOLES, before), rotation, atol=1e-12)
    assert np.linalg.det(turn_between(SOLES, before)) == pytest.approx(1.0)


def test_flat_ground_holds_the_vertical(guara: RobotModel) -> None:
    """On ground that appears flat, the error does not grow, however often gravity is carried."""
    gravity = GravityEstimate((0.0, 0.0, -1.0), 0.002)
    for _ in range(100):
        gravity = carry_gravity(gravity, SOLES[:3], SOLES[:3], SOLES, NOISE, guara.noise)
    assert gravity.sigma < 0.004
    np.testing.assert_allclose(gravity.gravity_in_base, (0.0, 0.0, -1.0), atol=1e-12)


def test_blocks_hardly_move_the_vertical(guara: RobotModel) -> None:
    """A support plane tilted by 5 degrees against a well-known vertical counts as terrain, and the sigma grows."""
    tilted = SOLES @ rotation_from_rpy(0.0, np.radians(5.0), 0.0).T
    before = GravityEstimate((0.0, 0.0, -1.0), 0.002)
    after = carry_gravity(before, tilted[:3], tilted[:3], tilted, NOISE, guara.noise)
    assert np.degrees(np.arccos(-after.gravity_in_base[2])) < 0.2
    assert after.sigma > before.sigma


def test_a_turned_body_carries_gravity_with_it(guara: RobotModel) -> None:
    """If the body tips over its feet, gravity tips the opposite way in `base_link`."""
    tip = rotation_from_rpy(0.0, 0.08, 0.0)
    now = SOLES @ tip
    after = carry_gravity(GravityEstimate((0.0, 0.0, -1.0), 0.002), now[:3], SOLES[:3], now, NOISE, guara.noise)
    np.testing.assert_allclose(after.gravity_in_base, tip.T @ (0.0, 0.0, -1.0), atol=1e-9)


def test_a_long_slope_does_not_draw_the_vertical(guara: RobotModel) -> None:
    """From level ground, known to 3 degrees, onto a slope of 12: after 40 pauses the error is within one sigma."""
    gravity = GravityEstimate((0.0, 0.0, -1.0), guara.noise.terrain_slope_sigma)
    sloping = SOLES + np.tan(np.radians(12.0)) * SOLES[:, :1] * (0.0, 0.0, 1.0)
    for _ in range(40):
        gravity = carry_gravity(gravity, SOLES[:3], SOLES[:3], sloping, NOISE, guara.noise)
    assert np.hypot(*gravity.gravity_in_base[:2]) < gravity.sigma
    assert guara.noise.terrain_slope_sigma < gravity.sigma < 2 * guara.noise.terrain_slope_sigma


def test_first_gravity_is_as_sure_as_terrain_is_level(guara: RobotModel) -> None:
    """Without an IMU, the first vertical is the support plane's normal, with the slope of terrain as its sigma."""
    pose = guara.stance_pose(Stance(guara.posture("scan"), guara.legs))
    np.testing.assert_allclose(pose.gravity.gravity_in_base, -pose.up_in_base)
    assert pose.gravity.sigma == pose.attitude_sigma
    assert pose.attitude_sigma == pytest.approx(guara.noise.terrain_slope_sigma, rel=0.01)
