"""Every fault that some reader of URDF passes over in silence is refused, by name."""

import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from kinematics import RobotFileError, RobotModel, load_robot
from kinematics.urdf import read_urdf, rotation_from_rpy

FAULTS = {
    "negative mass": ('<mass value="0.45"/>', '<mass value="-0.45"/>', "link 'lf_thigh_link': mass is -0.45 kg"),
    "zero mass": (
        '<mass value="0.45"/>',
        '<mass value="0"/>',
        "link 'lf_thigh_link': mass is 0 kg; it must be positive",
    ),
    "no mass": ('<mass value="0.45"/>', "", "link 'lf_thigh_link': <mass> is missing"),
    "triangle inequality": ('iyy="0.453125"', 'iyy="0.95"', "link 'base_link': principal moments of inertia"),
    "negative inertia": ('ixx="0.203125"', 'ixx="-0.2"', "link 'base_link': principal moments of inertia"),
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
    "NaN": ('xyz="0.400 0 0.140"', 'xyz="nan 0 0.140"', "needed: 3 finite numbers parted by spaces"),
    "unsupported type": (
        'name="lf_haa_joint" type="revolute"',
        'name="lf_haa_joint" type="continuous"',
        "joint 'lf_haa_joint': type 'continuous'",
    ),
    "mesh": ('<box size="0.60 0.40 0.05"/>', '<mesh filename="a.stl"/>', "element <mesh> is not allowed in <geometry>"),
    "flat box": (
        '<box size="0.60 0.40 0.05"/></geometry>\n    </collision>',
        '<box size="0.60 0.40 0"/></geometry>\n    </collision>',
        "link 'base_link': size of <box>",
    ),
    "moving link without inertia": (
        """<link name="lf_hip_link">
    <inertial>
      <origin xyz="0 0 0" rpy="0 0 0"/>
      <mass value="0.3"/>
      <inertia ixx="0.00018" ixy="0" ixz="0" iyy="0.00018" iyz="0" izz="0.00018"/>
    </inertial>
  </link>""",
        '<link name="lf_hip_link"/>',
        "link 'lf_hip_link': moves, but has no <inertial>",
    ),
    "a circle": (
        '<parent link="base_link"/>\n    <child link="camera_link"/>',
        '<parent link="camera_optical_frame"/>\n    <child link="camera_link"/>',
        "hangs in a circle of joints",
    ),
    "no XML": ("</robot>", "", "is not valid XML"),
    "other name": ('<robot name="guara">', '<robot name="lobo">', "the robot is named 'lobo', in robot.toml 'guara'"),
    "legs no mirror images: origin": (
        'xyz="0.300 -0.180 0"',
        'xyz="0.300 -0.181 0"',
        "no leg has its hip at the mirror image",
    ),
    "legs no mirror images: limits": (
        'lower="-1.6" upper="1.0"',
        'lower="-1.5" upper="1.0"',
        "are no mirror images: axis",
    ),
    "legs no mirror images: mass": (
        '<mass value="0.45"/>',
        '<mass value="0.46"/>',
        "are no mirror images: mass or inertia",
    ),
    "legs no mirror images: shape": (
        '<box size="0.035 0.035 0.15"/></geometry>\n    </collision>',
        '<box size="0.036 0.035 0.15"/></geometry>\n    </collision>',
        "are no mirror images: collision shapes",
    ),
    "sole larger than the foot": (
        '<box size="0.08 0.06 0.02"/></geometry>\n    </collision>',
        '<box size="0.07 0.06 0.02"/></geometry>\n    </collision>',
        "sole length is 0.08 m, but the collision shapes of the foot of leg 'lf' reach only 0.07 m",
    ),
    "camera at another height": ('xyz="0.400 0 0.140"', 'xyz="0.400 0 0.150"', "camera_height comes out at 0.5"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_fault_is_refused_by_name(fault: str, broken_folder: Callable[..., Path]) -> None:
    """A URDF with one fault is refused by a message that names the file or the table, and the place."""
    old, new, message = FAULTS[fault]
    with pytest.raises(RobotFileError) as caught:
        load_robot(broken_folder("urdf/guara.urdf", old, new))
    assert message in str(caught.value)
    assert "guara.urdf" in str(caught.value) or "robot.toml" in str(caught.value)


def test_check_urdf_agrees(robot: RobotModel) -> None:
    """The check_urdf program that comes with Pinocchio accepts the files too, with the same root."""
    program = shutil.which("check_urdf", path=str(Path(sys.executable).parent)) or shutil.which("check_urdf")
    assert program is not None, "check_urdf comes with pin (cmeel-urdfdom)"
    done = subprocess.run([program, str(robot.tree.urdf.path)], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0 and f"root Link: {robot.config.base_frame}" in done.stdout


def test_mujoco_compiles_the_guara(guara: RobotModel) -> None:
    """MuJoCo, which checks masses and inertias on its own, compiles the same file and finds the same mass."""
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
    """A URDF that is not there is named."""
    with pytest.raises(RobotFileError, match="nothing.urdf: cannot be read"):
        read_urdf(tmp_path / "nothing.urdf")
