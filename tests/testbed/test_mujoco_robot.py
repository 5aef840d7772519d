"""Tests of the robot as MuJoCo gets it, and of the MJCF file that lies beside the URDF."""

from __future__ import annotations

import re
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from guara_perception.exceptions import InvalidInput, optional_library
from kinematics import RobotModel, load_robot
from testbed.physics.__main__ import main
from testbed.physics.mujoco_robot import mjcf, mujoco_robot

needs_mujoco = pytest.mark.skipif(find_spec("mujoco") is None, reason="MuJoCo is not installed (extra `sim`)")
pytestmark = [pytest.mark.sim, pytest.mark.slow, needs_mujoco]

TAPIR = Path(__file__).parents[1] / "robots" / "tapir"


def test_the_committed_file_is_the_one_that_is_made(robot: RobotModel) -> None:
    """robots/guara/mjcf/guara.xml is what `python -m testbed.physics guara` writes now, in every number and name."""
    mujoco = optional_library("mujoco", "sim", "this test")
    path = robot.folder / "mjcf" / "guara.xml"
    text = mjcf(robot)
    kept, made = mujoco.MjModel.from_xml_path(str(path)), mujoco.MjModel.from_xml_string(text)
    assert kept.names == made.names
    compared = [name for name in dir(made) if isinstance(getattr(made, name), np.ndarray)]
    assert {"body_pos", "geom_rgba", "jnt_range", "actuator_forcerange", "key_qpos", "exclude_signature"} <= set(
        compared
    )
    for name in compared:
        np.testing.assert_allclose(getattr(kept, name), getattr(made, name), atol=1e-6, err_msg=name)
    assert not re.search("[/]home|[/]work|[/]tmp", path.read_text())


def test_it_stands_in_its_postures(robot: RobotModel) -> None:
    """Put on a plane in the posture of a keyframe, its servos hold it there."""
    mujoco = optional_library("mujoco", "sim", "this test")
    spec = mujoco.MjSpec.from_string(mjcf(robot))
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 0.05])
    model = spec.compile()
    data = mujoco.MjData(model)
    for key, name in enumerate(robot.posture_names):
        mujoco.mj_resetDataKeyframe(model, data, key)
        height = data.qpos[2]
        for _ in range(1000):
            mujoco.mj_step(model, data)
        assert data.qpos[2] == pytest.approx(height, abs=0.006)
        for joint, position in robot.posture(name).items():
            assert data.joint(joint).qpos[0] == pytest.approx(position, abs=0.03)


def test_a_robot_without_settings_for_mujoco(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Any robot folder: the command says what it wrote, links without mass stay."""
    mujoco = optional_library("mujoco", "sim", "this test")
    main([str(TAPIR), "-o", str(tmp_path / "tapir.xml")])
    tapir = load_robot(TAPIR)
    assert f"{len(tapir.joint_names)} servos, postures {', '.join(tapir.posture_names)}" in capsys.readouterr().out
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "tapir.xml"))
    assert model.nu == len(tapir.joint_names) and model.nbody == len(tapir.tree.links) + 1


def test_what_mujoco_refuses_is_reported(robot: RobotModel) -> None:
    """One line with the file and MuJoCo's own message."""
    text = robot.tree.urdf.text.replace('<mass value="0.45"/>', '<mass value="0"/>')
    tree = SimpleNamespace(urdf=SimpleNamespace(text=text, path=Path("guara.urdf")))
    broken = SimpleNamespace(tree=tree, config=robot.config, joint_names=robot.joint_names)
    with pytest.raises(InvalidInput, match="guara.urdf: MuJoCo rejects the URDF: .*mass"):
        mujoco_robot(broken)  # type: ignore[arg-type]
