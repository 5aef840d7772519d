"""Faults that some URDF reader accepts silently are rejected by name."""

import re
import shutil
import subprocess
import sys
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from kinematics import RobotFileError, RobotFileWarning, RobotModel, load_robot
from kinematics.read_urdf import read_urdf
from kinematics.urdf import rotation_from_rpy

FAULTS = {
    "negative mass": ('<mass value="0.45"/>', '<mass value="-0.45"/>', "link 'lf_thigh_link': mass is -0.45 kg"),
    "no mass": ('<mass value="0.45"/>', "", "link 'lf_thigh_link': <mass> is missing"),
    "zero axis": ('<axis xyz="1 0 0"/>', '<axis xyz="0 0 0"/>', "joint 'lf_haa_joint': the axis is zero"),
    "axis of length 2": (
        '<axis xyz="1 0 0"/>',
        '<axis xyz="2 0 0"/>',
        "joint 'lf_haa_joint': the axis (2, 0, 0) has length 2",
    ),
    "limits swapped": (
        'lower="-0.6" upper="0.6"',
        'lower="0.6" upper="-0.6"',
        "joint 'lf_haa_joint': the lower limit 0.6",
    ),
    "limits equal": (
        'lower="-0.6" upper="0.6"',
        'lower="0.6" upper="0.6"',
        "joint 'lf_haa_joint': the lower limit 0.6",
    ),
    "limit missing": (
        '<limit lower="-0.6" upper="0.6" effort="40" velocity="2"/>',
        "",
        "joint 'lf_haa_joint': <limit> is missing",
    ),
    "bound missing": ('lower="-0.6" upper', "upper", "joint 'lf_haa_joint': <limit> has no attribute 'lower'"),
    "misspelt element": (
        '<origin xyz="0.400',
        '<orgin xyz="0.400',
        "joint 'camera_joint': element <orgin> is not allowed",
    ),
    "misspelt attribute": (
        '<origin xyz="0.400',
        '<origin xzy="0.400',
        "joint 'camera_joint': attribute 'xzy' of <origin>",
    ),
    "two roots": (
        '<link name="imu_link"/>',
        '<link name="imu_link"/><link name="astray"/>',
        "two or more roots: 'base_link', 'astray'",
    ),
    "joint defined twice": ('name="rf_haa_joint"', 'name="lf_haa_joint"', "joint 'lf_haa_joint' is defined twice"),
    "link defined twice": (
        '<link name="imu_link"/>',
        '<link name="imu_link"/><link name="imu_link"/>',
        "link 'imu_link' is defined twice",
    ),
    "unknown child": (
        '<child link="imu_link"/>',
        '<child link="imu"/>',
        "joint 'imu_joint': child link 'imu' is not defined",
    ),
    "unknown parent": (
        '<parent link="lf_hip_link"/>',
        '<parent link="lf_hip"/>',
        "joint 'lf_hfe_joint': parent link 'lf_hip' is not defined",
    ),
    "two parents": (
        '<child link="imu_link"/>',
        '<child link="laser_link"/>',
        "link 'laser_link' is the child of two joints",
    ),
    "commas": (
        'xyz="0.400 0 0.140"',
        'xyz="0.400, 0, 0.140"',
        "joint 'camera_joint': xyz of <origin> is '0.400, 0, 0.140'",
    ),
    "NaN": ('xyz="0.400 0 0.140"', 'xyz="nan 0 0.140"', "needed: 3 finite numbers separated by spaces"),
    "unsupported type": (
        'name="lf_haa_joint" type="revolute"',
        'name="lf_haa_joint" type="planar"',
        "joint 'lf_haa_joint': type 'planar' is not supported; use fixed, revolute, continuous or prismatic",
    ),
    "element <shape> in <geometry>": (
        '<box size="0.60 0.40 0.05"/></geometry>\n    </collision>',
        "<superquadric/></geometry>\n    </collision>",
        "link 'base_link': <geometry> of <collision> holds 0 shapes",
    ),
    "legs no mirror images: length": (
        '<origin xyz="0 0 -0.150" rpy="0 0 0"/>',
        '<origin xyz="0 0 -0.151" rpy="0 0 0"/>',
        "legs 'lf' and 'rf' are not mirror images: from joint to joint they measure",
    ),
    "entities": (
        '<robot name="guara">',
        '<!DOCTYPE r [<!ENTITY a "b">]><robot name="guara">',
        "entity 'a' is defined; entities are not read",
    ),
    "flat box": (
        '<box size="0.60 0.40 0.05"/></geometry>\n    </collision>',
        '<box size="0.60 0.40 0"/></geometry>\n    </collision>',
        "link 'base_link': size of <box>",
    ),
    "a circle": (
        '<parent link="base_link"/>\n    <child link="camera_link"/>',
        '<parent link="camera_optical_frame"/>\n    <child link="camera_link"/>',
        "is in a loop of joints",
    ),
    "no XML": ("</robot>", "", "is not valid XML"),
    "other name": ('<robot name="guara">', '<robot name="lobo">', "is named 'lobo', but 'guara' in robot.toml"),
    "legs no mirror images: origin": (
        'xyz="0.300 -0.180 0"',
        'xyz="0.300 -0.181 0"',
        "no legs have their hip at the mirror image",
    ),
    "legs no mirror images: limits": (
        'lower="-1.6" upper="1.0"',
        'lower="-1.5" upper="1.0"',
        "are not mirror images: axis",
    ),
    "sole larger than the foot": (
        '<box size="0.08 0.06 0.02"/></geometry>\n    </collision>',
        '<box size="0.07 0.06 0.02"/></geometry>\n    </collision>',
        "sole length is 0.08 m, but the collision shapes of the foot of leg 'lf' cover only 0.07 m",
    ),
    "camera at another height": ('xyz="0.400 0 0.140"', 'xyz="0.400 0 0.150"', "camera_height is 0.5"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_fault_is_refused_by_name(fault: str, broken_folder: Callable[..., Path]) -> None:
    """A URDF with one fault is rejected with a message that names the file or table, and the element."""
    old, new, message = FAULTS[fault]
    with pytest.raises(RobotFileError) as caught:
        load_robot(broken_folder("urdf/guara.urdf", old, new))
    assert message in str(caught.value)
    assert "guara.urdf" in str(caught.value) or "robot.toml" in str(caught.value)


NOT_USED = {
    "zero mass": ('<mass value="0.45"/>', '<mass value="0"/>', None),
    "inertia of no body": ('iyy="0.453125"', 'iyy="0.95"', "<inertia> that is malformed or physically impossible"),
    "negative inertia": ('ixx="0.203125"', 'ixx="-0.2"', "<inertia> that is malformed or physically impossible"),
    "inertia missing": (
        '<inertia ixx="0.203125" ixy="0" ixz="0" iyy="0.453125" iyz="0" izz="0.65"/>',
        "",
        None,
    ),
    "masses that differ from side to side": ('<mass value="0.45"/>', '<mass value="0.46"/>', None),
    "shapes that differ from side to side": (
        '<box size="0.035 0.035 0.15"/></geometry>\n    </collision>',
        '<box size="0.036 0.035 0.15"/></geometry>\n    </collision>',
        None,
    ),
    "mesh as visual": ('<box size="0.60 0.40 0.05"/>', '<mesh filename="package://a/b.stl"/>', None),
    "a mesh that is not there": (
        '<box size="0.60 0.40 0.05"/></geometry>\n    </collision>',
        '<mesh filename="package://a/b.stl"/></geometry>\n    </collision>',
        "link 'base_link': a mesh is not used, so the self-filter ignores it: no mesh 'package://a/b.stl'",
    ),
    "tags of a vendor": (
        '<link name="imu_link"/>',
        '<link name="imu_link"><contact><stiffness value="1"/></contact><self_filter/></link>',
        "element <contact> in <link>; element <self_filter> in <link>",
    ),
    "attributes of a vendor": (
        'effort="40" velocity="2"',
        'effort="40" velocity="2" current="9"',
        "attribute 'current'",
    ),
    "a link without inertia moves": (
        """<link name="lf_hip_link">
    <inertial>
      <origin xyz="0 0 0" rpy="0 0 0"/>
      <mass value="0.3"/>
      <inertia ixx="0.00018" ixy="0" ixz="0" iyy="0.00018" iyz="0" izz="0.00018"/>
    </inertial>
  </link>""",
        '<link name="lf_hip_link"/>',
        None,
    ),
    "effort missing": ('upper="0.6" effort="40" velocity="2"', 'upper="0.6"', None),
}


@pytest.mark.parametrize("case", NOT_USED)
def test_what_is_not_used_is_passed_over_and_named(
    case: str, broken_folder: Callable[..., Path], guara: RobotModel
) -> None:
    """Unused content is listed in one warning, and does not change the robot."""
    old, new, message = NOT_USED[case]
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        robot = load_robot(broken_folder("urdf/guara.urdf", old, new))
    reported = [str(warning.message) for warning in caught if issubclass(warning.category, RobotFileWarning)]
    assert len(reported) == (message is not None) and all(str(message) in text for text in reported)
    for leg in robot.legs:
        soles = robot.state(robot.posture("scan")).soles_in_base([leg])
        np.testing.assert_array_equal(soles, guara.state(guara.posture("scan")).soles_in_base([leg]))


def test_all_findings_come_at_once_with_their_lines(broken_folder: Callable[..., Path]) -> None:
    """Three faults in one file give three findings, in file order, each with its line."""
    folder = broken_folder("robot.toml", "name", "name")
    path = folder / "urdf" / "guara.urdf"
    text = path.read_text().replace('xyz="0.400 0 0.140"', 'xyz="0.400, 0, 0.140"')
    text = text.replace('lower="-0.6" upper="0.6"', 'upper="0.6"', 1).replace("<axis xyz", "<axes xyz", 1)
    path.write_text(text)
    with pytest.raises(RobotFileError) as caught:
        load_robot(folder)
    findings = caught.value.findings
    assert len(findings) == 3 and str(caught.value).startswith("3 errors: (1) ")
    lines = [int(re.match(rf"{re.escape(str(path))}:(\d+): ", finding)[1]) for finding in findings]  # type: ignore[index]
    assert lines == sorted(lines)
    for line, word in zip(lines, ("0.400, 0, 0.140", "<axes", "<limit"), strict=True):
        assert word in text.splitlines()[line - 1]


def test_a_continuous_joint_turns_either_way(broken_folder: Callable[..., Path], guara: RobotModel) -> None:
    """Continuous hips load as joints of one angle from -pi to pi, with the poses of revolute ones."""
    path = broken_folder("robot.toml", "name", "name") / "urdf" / "guara.urdf"
    text = re.sub(r'(_haa_joint") type="revolute"', r'\1 type="continuous"', path.read_text())
    path.write_text(text.replace('<limit lower="-0.6" upper="0.6" effort="40" velocity="2"/>', ""))
    robot = load_robot(path.parent.parent)
    index = robot.joint_names.index("lf_haa_joint")
    assert (robot.tree.lower_limits[index], robot.tree.upper_limits[index]) == (-np.pi, np.pi)
    posture = {**robot.posture("scan"), "lf_haa_joint": 0.3}
    np.testing.assert_array_equal(robot.state(posture).soles_in_base(), guara.state(posture).soles_in_base())


def test_a_chain_of_thousands_of_joints_is_refused_at_once(broken_folder: Callable[..., Path]) -> None:
    """3,000 joints besides those of the legs are rejected before the tree is built."""
    link = '<link name="l{0}"/><joint name="j{0}" type="revolute"><parent link="{1}"/><child link="l{0}"/>'
    limit = '<axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
    chain = "".join((link + limit).format(i, f"l{i - 1}" if i else "base_link") for i in range(3000))
    folder = broken_folder("urdf/guara.urdf", "</robot>", f"{chain}</robot>")
    with pytest.raises(RobotFileError, match="3016 joints move; allowed: up to 256. Make those that carry no foot"):
        load_robot(folder)


def test_a_file_of_a_size_that_no_robot_has_is_refused(broken_folder: Callable[..., Path]) -> None:
    """Files of more than sixteen megabytes are not read."""
    path = broken_folder("robot.toml", "name", "name") / "urdf" / "guara.urdf"
    path.write_text(path.read_text() + " " * 17 * 1024 * 1024)
    with pytest.raises(RobotFileError, match="at most 16777216 are read"):
        load_robot(path.parent.parent)


def test_check_urdf_agrees(robot: RobotModel) -> None:
    """The program check_urdf that comes with Pinocchio accepts the files too, with the same root."""
    program = shutil.which("check_urdf", path=str(Path(sys.executable).parent)) or shutil.which("check_urdf")
    assert program is not None, "check_urdf comes with pin (cmeel-urdfdom)"
    done = subprocess.run([program, str(robot.tree.urdf.path)], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0 and f"root Link: {robot.config.base_frame}" in done.stdout


@pytest.mark.slow
def test_mujoco_compiles_the_guara(guara: RobotModel) -> None:
    """MuJoCo, which checks masses and inertias itself, compiles the same file with the same mass."""
    mujoco = pytest.importorskip("mujoco", reason="the extra `sim` is not installed")
    model = mujoco.MjModel.from_xml_string(guara.tree.urdf.text)
    masses = sum(link.mass or 0.0 for link in guara.tree.urdf.links)
    assert model.body_mass.sum() == pytest.approx(masses, abs=1e-9)
    assert model.njnt == len(guara.joint_names)


def test_rpy_turns_about_fixed_axes() -> None:
    """Roll, pitch, yaw is Rz(yaw) Ry(pitch) Rx(roll)."""

    def about(axis: int, angle: float) -> np.ndarray:
        other = [i for i in range(3) if i != axis]
        rotation = np.eye(3)
        rotation[np.ix_(other, other)] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
        return rotation if axis != 1 else rotation.T

    np.testing.assert_allclose(
        rotation_from_rpy(0.3, -0.5, 1.1), about(2, 1.1) @ about(1, -0.5) @ about(0, 0.3), atol=1e-15
    )


def test_missing_file_is_named(tmp_path: Path) -> None:
    """The error for a missing URDF names the file."""
    with pytest.raises(RobotFileError, match="nothing.urdf: cannot be read"):
        read_urdf(tmp_path / "nothing.urdf")
