import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinematics import (
    ATTITUDE_SOURCES,
    ArgumentError,
    GravityEstimate,
    RobotModel,
    Stance,
    StanceError,
    load_robot,
    stance_pose,
)
from kinematics.footprint import fit_support_plane, transform_base_to_footprint
from kinematics.stance_pose import sole_covariances
from kinematics.urdf import rotation_from_rpy
from tests.thorough import examples

# Recorded stance: body pitched 3 degrees nose down and rolled 2 degrees, hips 0.360 m above a flat floor.
TILT = {
    "lf": (-0.034593375, -0.634912534, 1.164447867, -0.581895211),
    "rf": (-0.035231454, -0.709851431, 1.308766086, -0.651274533),
    "lh": (-0.034619156, -0.398145322, 0.696818949, -0.351033504),
    "rh": (-0.035203803, -0.507439267, 0.910770229, -0.455690839),
}
TILT_GRAVITY = (0.052335956, -0.034851668, -0.998021197)

GUARA = load_robot("guara")


def tilted(robot: RobotModel, gravity: bool = True, feet: tuple[str, ...] | None = None) -> Stance:
    joints = {
        joint: angle for leg in robot.legs for joint, angle in zip(robot.tree.leg(leg).joints, TILT[leg], strict=True)
    }
    return Stance(joints, feet or robot.legs, TILT_GRAVITY if gravity else None)


def lifted(robot: RobotModel, leg: str, by: float, gravity: bool = False, posture: str = "scan") -> Stance:
    """Scan posture with one foot above the floor that is nevertheless named as supporting."""
    joints = robot.posture(posture)
    state = robot.state(joints)
    found = robot.reach(leg, state.soles_in_base([leg])[0] + (0.0, 0.0, by))
    assert found.is_reachable
    joints.update(zip(robot.tree.leg(leg).joints, found.joint_positions.tolist(), strict=True))
    return Stance(joints, robot.legs, (0.0, 0.0, -1.0) if gravity else None)


@pytest.mark.parametrize("gravity", [True, False])
def test_recorded_tilt_is_found(guara: RobotModel, gravity: bool) -> None:
    """With and without gravity, a recorded stance gives its tilt of 3 and 2 degrees, its height and a level camera."""
    pose = guara.stance_pose(tilted(guara, gravity))
    assert pose.attitude_source == ("imu" if gravity else "support_plane")
    assert math.degrees(pose.pitch) == pytest.approx(3.0, abs=1e-4)
    assert math.degrees(pose.roll) == pytest.approx(2.0, abs=1e-4)
    assert pose.height == pytest.approx(0.360, abs=1e-6)
    assert pose.support_residual < 1e-6 and pose.unloaded_feet == ()
    np.testing.assert_allclose(pose.soles_in_footprint[:, 2], 0.0, atol=1e-6)
    # The soles are vertically below the hips of the level body.
    np.testing.assert_allclose(pose.soles_in_footprint[0], [0.300, 0.180, 0.0], atol=1e-6)


def test_signs_of_roll_and_pitch(guara: RobotModel) -> None:
    """Nose down is positive pitch, with gravity towards +x; left side up is positive roll, with gravity towards -y."""
    joints = guara.posture("scan")
    nose_down = guara.stance_pose(Stance(joints, guara.legs, (math.sin(0.1), 0.0, -math.cos(0.1))))
    assert nose_down.pitch == pytest.approx(0.1) and nose_down.roll == pytest.approx(0.0)
    left_up = guara.stance_pose(Stance(joints, guara.legs, (0.0, -math.sin(0.1), -math.cos(0.1))))
    assert left_up.roll == pytest.approx(0.1) and left_up.pitch == pytest.approx(0.0)
    # A point ahead of a body that is pitched nose down is lower than the body.
    ahead = nose_down.transform_base_to_footprint @ (1.0, 0.0, 0.0, 1.0)
    assert ahead[2] < nose_down.height


@settings(max_examples=examples(60), derandomize=True, deadline=None)
@given(
    roll=st.floats(-0.3, 0.3),
    pitch=st.floats(-0.3, 0.3),
    length=st.floats(0.1, 20.0),
    feet=st.sampled_from([("lf", "rf", "lh"), ("lf", "rf", "lh", "rh"), ("rf",), ("lh", "rf")]),
)
def test_footprint_definition(roll: float, pitch: float, length: float, feet: tuple[str, ...]) -> None:
    """The footprint is vertically below the body, level, with the body's heading and z = 0 at the mean of the soles."""
    rotation = rotation_from_rpy(roll, pitch, 0.0)
    gravity = rotation.T @ (0.0, 0.0, -length)
    pose = GUARA.stance_pose(Stance(GUARA.posture("scan"), feet, tuple(gravity.tolist())), find_unloaded=False)
    transform = pose.transform_base_to_footprint
    np.testing.assert_allclose(transform[:3, :3], rotation, atol=1e-12)
    np.testing.assert_allclose(transform[:2, 3], 0.0, atol=1e-15)
    np.testing.assert_allclose(transform[:3, :3] @ gravity, [0.0, 0.0, -length], atol=1e-9)
    assert pose.soles_in_footprint[:, 2].mean() == pytest.approx(0.0, abs=1e-12)
    # Heading: the body's x axis stays in the footprint's x-z plane.
    assert transform[1, 0] == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(pose.transform_footprint_to_base @ transform, np.eye(4), atol=1e-12)


@pytest.mark.parametrize("length", [1e-308, 1e-300, 1e-160, 1.0, 1e160, 1e307])
def test_gravity_of_any_length_gives_the_same_pose(guara: RobotModel, length: float) -> None:
    """Lengths whose squares are 0 or infinite, for an IMU and for carried gravity."""
    gravity = tuple((length * np.array(TILT_GRAVITY) / np.linalg.norm(TILT_GRAVITY)).tolist())
    expected = guara.stance_pose(tilted(guara)).transform_base_to_footprint
    for odometry in (None, GravityEstimate(gravity, 0.005)):
        stance = Stance(tilted(guara).joint_positions, guara.legs, None if odometry else gravity)
        pose = guara.stance_pose(stance, odometry=odometry)
        np.testing.assert_allclose(pose.transform_base_to_footprint, expected, atol=1e-12)


def test_best_source_is_taken_and_named(guara: RobotModel) -> None:
    """Gravity precedes odometry, which precedes the support plane; each can be requested, `level` only by request."""
    odometry = GravityEstimate((0.01, 0.0, -1.0), 0.005)
    assert guara.stance_pose(tilted(guara), odometry=odometry).attitude_source == "imu"
    assert guara.stance_pose(tilted(guara, False), odometry=odometry).attitude_source == "odometry"
    assert guara.stance_pose(tilted(guara, False)).attitude_source == "support_plane"
    for source in ATTITUDE_SOURCES:
        pose = guara.stance_pose(tilted(guara), odometry=odometry, attitude=source)
        assert pose.attitude_source == source
    level = guara.stance_pose(tilted(guara), attitude="level")
    assert level.pitch == 0.0 and level.roll == 0.0
    carried = guara.stance_pose(tilted(guara, False), odometry=odometry)
    assert carried.pitch == pytest.approx(0.01, rel=1e-3)


def test_attitude_is_as_sure_as_its_source(guara: RobotModel) -> None:
    """Sigmas are those of robot.toml; the support plane adds the slope of the ground to the noise of its soles."""
    odometry, noise = GravityEstimate((0.01, 0.0, -1.0), 0.005), guara.noise
    expected = {"imu": noise.imu_sigma, "odometry": 0.005, "level": noise.level_sigma}
    for source, sigma in expected.items():
        assert guara.stance_pose(tilted(guara), odometry=odometry, attitude=source).attitude_sigma == sigma
    plane = guara.stance_pose(tilted(guara, False))
    soles = np.mean(np.diag(plane.covariance)[3:5])
    assert plane.attitude_sigma == pytest.approx(np.hypot(noise.terrain_slope_sigma, np.sqrt(soles)))


def test_sources_that_are_not_there_are_refused(guara: RobotModel) -> None:
    """An attitude source that the stance lacks is rejected, as is an unknown source."""
    with pytest.raises(StanceError, match="attitude 'imu' was requested, but the stance has no gravity_in_base"):
        guara.stance_pose(tilted(guara, False), attitude="imu")
    with pytest.raises(StanceError, match="attitude 'odometry' was requested, but no odometry was given"):
        guara.stance_pose(tilted(guara), attitude="odometry")
    with pytest.raises(ArgumentError, match="attitude is 'gyro'; allowed: None, 'imu', 'odometry', 'supp"):
        guara.stance_pose(tilted(guara), attitude="gyro")


@pytest.mark.parametrize("gravity", [(0.0, 0.0, 0.0), (0.0, 0.0, 9.81), (0.0, 0.0, float("nan")), (0.0, -1.0)])
def test_gravity_that_does_not_point_down_is_refused(guara: RobotModel, gravity: tuple[float, ...]) -> None:
    """For an IMU and for carried gravity."""
    state = guara.state(guara.posture("scan"))
    carried = GravityEstimate(gravity, 0.01)
    for said in ({"gravity_in_base": gravity}, {"odometry": carried}):
        with pytest.raises(StanceError, match="gravity_in_base"):
            stance_pose(state, guara.legs, noise=guara.noise, **said)


def test_few_feet_need_gravity(guara: RobotModel) -> None:
    """With gravity one foot suffices, without it three are needed; no foot at all is always rejected."""
    assert guara.stance_pose(tilted(guara, True, ("lf",))).height == pytest.approx(0.36, abs=1e-5)
    with pytest.raises(
        StanceError, match="attitude from 'support_plane' needs 3 or more; otherwise use attitude 'imu' with"
    ):
        guara.stance_pose(tilted(guara, False, ("lf", "rh")))
    with pytest.raises(StanceError, match="attitude from 'level' needs 3 or more"):
        guara.stance_pose(tilted(guara, False, ("lf", "rh")), attitude="level")
    with pytest.raises(StanceError, match=r"support_feet: 0 given \(none\); attitude from 'imu' needs 1"):
        guara.stance_pose(Stance(guara.posture("scan"), (), (0.0, 0.0, -1.0)))
    assert math.isnan(guara.stance_pose(tilted(guara, True, ("lf", "rh"))).support_residual)


def test_a_fallen_body_is_refused(guara: RobotModel) -> None:
    """A body tilted by more than 60 degrees has no stance pose."""
    with pytest.raises(StanceError, match=r"the body is tilted by 71 degrees \(attitude from 'imu'\)"):
        guara.stance_pose(Stance(guara.posture("scan"), guara.legs, (math.tan(math.radians(71)), 0.0, -1.0)))


@pytest.mark.parametrize("by", [0.012, 0.030])
@pytest.mark.parametrize("gravity", [True, False])
def test_one_unloaded_foot_is_left_out(robot: RobotModel, gravity: bool, by: float) -> None:
    """Any hanging foot of four is found, and the pose is that of the other three."""
    for leg in robot.legs:
        pose = robot.stance_pose(lifted(robot, leg, by, gravity))
        assert pose.unloaded_feet == (leg,)
        assert set(pose.support_feet_used) == set(robot.legs) - {leg}
        assert pose.pitch == pytest.approx(0.0, abs=1e-9) and pose.roll == pytest.approx(0.0, abs=1e-9)
        expected = robot.stance_pose(Stance(robot.posture("scan"), robot.legs)).height
        assert pose.height == pytest.approx(expected, abs=1e-9)
        kept = robot.stance_pose(lifted(robot, leg, by, gravity), find_unloaded=False)
        assert kept.unloaded_feet == () and kept.support_residual > by / 5.0


@pytest.mark.slow
def test_noise_does_not_unload_a_foot(guara: RobotModel) -> None:
    """With the joint noise of robot.toml, almost none of 400 stances on a flat floor loses a foot."""
    rng, lost = np.random.default_rng(5), 0
    for _ in range(400):
        joints = {name: value + rng.normal(0.0, 0.0035) for name, value in guara.posture("scan").items()}
        lost += bool(guara.stance_pose(Stance(joints, guara.legs)).unloaded_feet)
    assert lost <= 2


def test_feet_on_uneven_ground_all_count_where_gravity_is_known(guara: RobotModel) -> None:
    """With gravity, feet of which no three are level are all used, and z = 0 stays at the mean of the soles."""
    joints, state = guara.posture("scan"), guara.state(guara.posture("scan"))
    heights = dict(zip(guara.legs, (0.040, 0.0, 0.0, 0.020), strict=True))
    for leg, height in heights.items():
        found = guara.reach(leg, state.soles_in_base([leg])[0] + (0.0, 0.0, height))
        joints.update(zip(guara.tree.leg(leg).joints, found.joint_positions.tolist(), strict=True))
    pose = guara.stance_pose(Stance(joints, guara.legs, (0.0, 0.0, -1.0)))
    assert pose.unloaded_feet == ()
    assert pose.height == pytest.approx(0.360 - np.mean(list(heights.values())), abs=1e-9)


def sampled_covariance(stance: Stance, attitude: str, count: int) -> np.ndarray:
    """Covariance of the body's pose over noisy soles and verticals by sampling, in REP-103 order."""
    rng, noise = np.random.default_rng(11), GUARA.noise
    state = GUARA.state(stance.joint_positions)
    legs = stance.support_feet
    soles = state.soles_in_base(legs)
    roots = [np.linalg.cholesky(c) for c in sole_covariances(state, legs, noise)]
    samples = np.zeros((count, 6))
    nominal = None
    for row in range(-1, count):
        noisy = soles.copy()
        if row >= 0:
            noisy += np.array([root @ rng.normal(size=3) for root in roots])
        if attitude == "imu":
            up = -np.array(stance.gravity_in_base) / np.linalg.norm(stance.gravity_in_base)
            if row >= 0:
                up = up + rng.normal(0.0, noise.imu_sigma, 3)
                up /= np.linalg.norm(up)
        else:
            up = fit_support_plane(noisy).normal
        pose = transform_base_to_footprint(noisy, up)
        if nominal is None:
            nominal = pose
            continue
        turned = pose[:3, :3] @ nominal[:3, :3].T
        samples[row, :3] = pose[:3, 3] - nominal[:3, 3]
        samples[row, 3:] = (turned - turned.T)[[2, 0, 1], [1, 2, 0]] / 2.0
    return np.cov(samples.T)


@pytest.mark.slow
@pytest.mark.parametrize("attitude", ["imu", "support_plane"])
@pytest.mark.parametrize("feet", [("lf", "rf", "lh", "rh"), ("lf", "rf", "rh")])
def test_covariance_agrees_with_sampling(attitude: str, feet: tuple[str, ...]) -> None:
    """Sigmas of the body's pose agree with Monte Carlo within 10 %, and so do the correlations."""
    stance = tilted(GUARA, attitude == "imu", feet)
    # x and y are exact by definition, and the heading is exact apart from the tilt.
    uncertain = np.ix_([2, 3, 4], [2, 3, 4])
    found = GUARA.stance_pose(stance, find_unloaded=False).covariance[uncertain]
    sampled = sampled_covariance(stance, attitude, examples(4200))[uncertain]
    sigmas = np.sqrt(np.diag(sampled))
    np.testing.assert_allclose(np.sqrt(np.diag(found)), sigmas, rtol=0.10)
    correlations = (found - sampled) / np.outer(sigmas, sigmas)
    assert np.abs(correlations).max() < 0.10


@pytest.mark.slow
def test_footprint_covariance_agrees_with_noisy_joints(guara: RobotModel) -> None:
    """For joint noise alone (0.2 degrees), the covariance agrees with sampling of joint angles."""
    rng, stance = np.random.default_rng(7), tilted(guara, False)
    noise = type(guara.noise)(
        **{f: getattr(guara.noise, f) for f in guara.noise.__dataclass_fields__} | {"contact_sigma": 1e-9}
    )
    nominal = guara.stance_pose(stance, noise=noise, find_unloaded=False)
    samples = []
    for _ in range(800):
        joints = {name: value + rng.normal(0.0, noise.encoder_sigma) for name, value in stance.joint_positions.items()}
        pose = guara.stance_pose(Stance(joints, guara.legs), noise=noise, find_unloaded=False)
        turned = pose.transform_base_to_footprint[:3, :3] @ nominal.transform_base_to_footprint[:3, :3].T
        samples.append([pose.height - nominal.height, (turned - turned.T)[2, 1] / 2, (turned - turned.T)[0, 2] / 2])
    predicted = np.sqrt(np.diag(nominal.covariance))[[2, 3, 4]]
    np.testing.assert_allclose(predicted, np.std(samples, axis=0), rtol=0.10)


def test_calibrated_camera_overrides_the_nominal(guara: RobotModel) -> None:
    """The calibrated camera pose is used unchanged; the nominal pose is used only without one."""
    camera = guara.transform_camera_to_base.copy()
    camera[:3, 3] += (0.003, -0.002, 0.001)
    nominal = guara.stance_pose(tilted(guara))
    pose = guara.stance_pose(tilted(guara), transform_camera_to_base=camera)
    np.testing.assert_allclose(
        pose.transform_camera_to_footprint, pose.transform_base_to_footprint @ camera, atol=1e-15
    )
    shift = pose.transform_camera_to_footprint[:3, 3] - nominal.transform_camera_to_footprint[:3, 3]
    assert np.linalg.norm(shift) == pytest.approx(np.linalg.norm((0.003, 0.002, 0.001)))


def test_results_are_read_only(guara: RobotModel) -> None:
    """No array of a pose can be written."""
    pose = guara.stance_pose(tilted(guara))
    for array in (
        pose.transform_base_to_footprint,
        pose.covariance,
        pose.soles_in_footprint,
        pose.transform_camera_to_footprint,
        pose.transform_footprint_to_base,
        pose.up_in_base,
    ):
        assert not array.flags.writeable
