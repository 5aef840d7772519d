"""Properties of every robot folder, and properties of the Guará."""

import math
from pathlib import Path

import numpy as np
import pytest

from kinematics import (
    ArgumentError,
    JointLimitWarning,
    JointPositionError,
    RobotModel,
    RobotNotFound,
    Stance,
    StanceError,
    UnknownName,
    load_robot,
)
from kinematics.load import ROBOTS_FOLDER


def test_names_follow_robot_toml(robot: RobotModel) -> None:
    """Joint names are ordered leg by leg from hip to sole as in robot.toml, whatever Pinocchio's order."""
    expected = [joint for leg in robot.config.legs for joint in leg.joints]
    assert list(robot.joint_names) == expected
    assert robot.legs == tuple(leg.name for leg in robot.config.legs)


def test_every_shipped_robot_is_found_by_name() -> None:
    """Every folder of `robots` loads by name and by path, as the same robot."""
    names = [path.parent.name for path in ROBOTS_FOLDER.glob("*/robot.toml")]
    assert "guara" in names
    for name in names:
        assert load_robot(name).name == name == load_robot(ROBOTS_FOLDER / name).name


def test_unknown_robot_lists_the_names() -> None:
    """An unknown robot is rejected with the list of available names."""
    with pytest.raises(RobotNotFound, match="no robot 'lobo'.*names guara") as caught:
        load_robot("lobo")
    assert isinstance(caught.value, FileNotFoundError)
    with pytest.raises(ArgumentError, match="robot is ''"):
        load_robot("")
    with pytest.raises(RobotNotFound):
        load_robot(Path("/nowhere"))


def test_soles_stand_on_one_plane_in_every_posture(robot: RobotModel) -> None:
    """In each posture, all soles are at one height, with hips and camera above them as robot.toml states."""
    for posture in robot.config.postures:
        state = robot.state(robot.posture(posture.name))
        soles = state.soles_in_base()
        np.testing.assert_allclose(soles[:, 2], soles[0, 2], atol=1e-9)
        camera = state.position_in_base(robot.config.camera_frame)
        assert camera[2] - soles[0, 2] == pytest.approx(posture.camera_height, abs=5e-4)
        for leg in robot.config.legs:
            assert state.position_in_base(leg.hip)[2] - soles[0, 2] == pytest.approx(posture.hip_height, abs=5e-4)


def test_scan_posture_sees_the_area(robot: RobotModel) -> None:
    """In the scan posture, every corner of the scanned area is in front of the camera and within 75 degrees."""
    pose = robot.stance_pose(Stance(robot.posture(robot.config.scan_posture), robot.legs))
    area = robot.config.root.table("grid").table("footprint").values
    for x in area["x"]:  # type: ignore[index]
        for y in area["y"]:  # type: ignore[index]
            in_camera = np.linalg.solve(pose.transform_camera_to_footprint, [x, y, 0.0, 1.0])[:3]
            assert in_camera[2] > 0.3
            assert max(abs(in_camera[:2] / in_camera[2])) < math.tan(math.radians(37.5))


def test_scan_pattern_covers_the_area(robot: RobotModel) -> None:
    """The first and last nominal laser planes meet the floor just outside the scanned area."""
    state = robot.state(robot.posture(robot.config.scan_posture))
    mirror = state.position_in_base(robot.config.laser_frame)
    height = mirror[2] - state.soles_in_base()[:, 2].mean()
    near, far = robot.config.root.table("grid").table("footprint").pair("x")
    scan = robot.config.root.table("scan").values
    # The laser plane turns by twice the mirror angle; at zero it points along -z, at positive angles forward.
    first = mirror[0] + height * math.tan(2.0 * scan["mirror_angle_first"])  # type: ignore[operator]
    last = mirror[0] + height * math.tan(2.0 * scan["mirror_angle_last"])  # type: ignore[operator]
    assert near - 0.02 < first < near
    assert far < last < far + 0.02


def test_guara_camera_is_eq_5(guara: RobotModel) -> None:
    """The nominal mount is eq. 5 of the paper at 31 degrees, with the origin of eq. 6 behind it at camera height."""
    alpha = math.radians(31.0)
    eq_5 = np.array(
        [
            [0.0, math.cos(alpha), math.sin(alpha)],
            [1.0, 0.0, 0.0],
            [0.0, math.sin(alpha), -math.cos(alpha)],
        ]
    )
    np.testing.assert_allclose(guara.transform_camera_to_base[:3, :3], eq_5, atol=1e-15)
    np.testing.assert_allclose(guara.transform_camera_to_base[:3, 3], [0.400, 0.0, 0.140], atol=1e-12)
    rangefinder = guara.state(guara.posture("scan")).transform_to_base("rangefinder_frame")
    in_rangefinder = np.linalg.solve(rangefinder, guara.transform_camera_to_base[:, 3])
    np.testing.assert_allclose(in_rangefinder[1:3], 0.0, atol=1e-15)


def test_guara_postures_are_the_published_ones(guara: RobotModel) -> None:
    """Standing is HFE -22.5, KFE 45, AFE -22.5 degrees; in the scan posture the camera is at 0.500 m."""
    standing = guara.posture("standing")
    for leg in guara.legs:
        angles = [math.degrees(standing[joint]) for joint in guara.tree.leg(leg).joints]
        assert angles == pytest.approx([0.0, -22.5, 45.0, -22.5], abs=1e-9)
    pose = guara.stance_pose(Stance(guara.posture("scan"), guara.legs))
    assert pose.height == pytest.approx(0.360, abs=1e-9)
    assert pose.transform_camera_to_footprint[2, 3] == pytest.approx(0.500, abs=1e-9)
    np.testing.assert_allclose(guara.transform_laser_to_base[:3, 3], [0.600, 0.0, 0.110], atol=1e-12)


def test_unknown_names_are_refused_with_those_there_are(robot: RobotModel) -> None:
    """Misspelt frames, legs, postures and joints are rejected, each with the list of valid names."""
    state = robot.state(robot.posture(robot.config.scan_posture))
    with pytest.raises(UnknownName, match="unknown frame 'cammera'.*" + robot.config.camera_frame):
        state.transform_to_base("cammera")
    with pytest.raises(UnknownName, match="unknown leg 'xx'; this robot has: " + robot.legs[0]):
        state.soles_in_base(["xx"])
    with pytest.raises(UnknownName, match="unknown posture 'sit'.*scan"):
        robot.posture("sit")
    with pytest.raises(UnknownName, match="unknown joint 'knee'.*" + robot.joint_names[0]) as caught:
        robot.state({**robot.posture("scan"), "knee": 0.0})
    assert isinstance(caught.value, KeyError) and not str(caught.value).startswith('"')
    with pytest.raises(UnknownName, match="unknown leg 'xx'"):
        robot.stance_pose(Stance(robot.posture("scan"), ("xx", *robot.legs)))


def test_bad_joint_positions_are_refused(robot: RobotModel) -> None:
    """Missing joints, NaN, wrong length and non-numbers are rejected by name."""
    good = robot.posture("scan")
    first = robot.joint_names[0]
    with pytest.raises(JointPositionError, match=f"no position for {first}; all {len(good)} joints"):
        robot.state({name: value for name, value in good.items() if name != first})
    with pytest.raises(JointPositionError, match=f"joint {first}: position nan is not finite"):
        robot.state({**good, first: math.nan})
    with pytest.raises(JointPositionError, match=rf"shape \(3,\); \({len(good)},\) is needed, in the order {first}"):
        robot.state([0.0, 0.0, 0.0])
    with pytest.raises(JointPositionError, match=r"shape \(1, "):
        robot.state(np.zeros((1, len(good))))
    with pytest.raises(JointPositionError, match="are not numbers"):
        robot.state({**good, first: "straight"})  # type: ignore[dict-item]


def test_joints_beyond_their_limits_are_warned_of(robot: RobotModel) -> None:
    """A joint beyond its limits is accepted, reported with its excess, and named in a warning."""
    joint = robot.joint_names[0]
    limit = robot.tree.upper_limits[0]
    with pytest.warns(JointLimitWarning, match=f"joint {joint} is at .* rad, 0.1000 rad beyond its limits"):
        state = robot.state({**robot.posture("scan"), joint: limit + 0.1})
    assert dict(state.beyond_limits) == pytest.approx({joint: 0.1})
    assert state.joint_positions[joint] == pytest.approx(limit + 0.1)


def test_an_array_in_joint_order_is_the_same_as_a_mapping(robot: RobotModel) -> None:
    """Positions by name and positions in the order of joint_names give the same state."""
    rng = np.random.default_rng(3)
    positions = rng.uniform(robot.tree.lower_limits, robot.tree.upper_limits)
    by_name = dict(zip(robot.joint_names, positions, strict=True))
    shuffled = dict(sorted(by_name.items(), key=lambda item: hash(item[0])))
    np.testing.assert_array_equal(robot.state(positions).soles_in_base(), robot.state(shuffled).soles_in_base())


def test_a_scan_needs_feet(robot: RobotModel) -> None:
    """Two feet or fewer without gravity are rejected with advice."""
    for count in (0, 1, 2):
        with pytest.raises(
            StanceError, match=rf"support_feet: {count} given .* needs 3 or more; otherwise use attitude 'imu'"
        ):
            robot.stance_pose(Stance(robot.posture("scan"), robot.legs[:count]))


def test_second_robot_sees_the_floor_as_the_first(guara: RobotModel, tapir: RobotModel) -> None:
    """Camera and mirror of both robots are at the same place above the floor, so scans can be exchanged."""
    poses = [robot.stance_pose(Stance(robot.posture("scan"), robot.legs)) for robot in (guara, tapir)]
    camera, other_camera = (pose.transform_camera_to_footprint for pose in poses)
    np.testing.assert_allclose(camera, other_camera, atol=1e-9)
    laser, other_laser = (
        pose.transform_base_to_footprint @ robot.transform_laser_to_base
        for robot, pose in zip((guara, tapir), poses, strict=True)
    )
    np.testing.assert_allclose(laser, other_laser, atol=1e-9)
