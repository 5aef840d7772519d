"""The Guará's URDF in third-party readers: all of it arrives; what each reports is in docs/robot-model.md."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinematics import RobotModel

pytestmark = [pytest.mark.robots, pytest.mark.slow]

LINKS, JOINTS, MOVING, VISUALS, COLLISIONS, MASS = 26, 25, 16, 62, 17, 20.4
# Links without mass; PyBullet prints one line about each.
MASSLESS = 9


def reader(name: str, extra: str = "robots-test") -> Any:
    """A library, or a skip that says how to get it."""
    return pytest.importorskip(name, reason=f"{name} is not installed (extra `{extra}`)")


@pytest.fixture(scope="module")
def urdf(robot: RobotModel) -> Path:
    return robot.tree.urdf.path


@pytest.fixture(scope="module")
def expected(robot: RobotModel) -> dict[str, np.ndarray]:
    """Every link's pose in base_link in the scan posture, (4, 4), by our own kinematics."""
    state = robot.state(robot.posture("scan"))
    return {link: state.transform_to_base(link) for link in robot.tree.links}


def test_check_urdf(urdf: Path) -> None:
    """urdfdom's own program, as it comes with Pinocchio, parses it and prints the tree without a warning."""
    program = Path(sys.executable).with_name("check_urdf")
    done = subprocess.run([program, urdf], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0 and done.stderr == ""
    assert "robot name is: guara" in done.stdout and "root Link: base_link has 8 child(ren)" in done.stdout


def test_pinocchio(urdf: Path, robot: RobotModel, expected: dict[str, np.ndarray], capfd: Any) -> None:
    """Pinocchio's own reader of URDF and SRDF: shapes, colours, limits, mass, postures, poses of all links."""
    import pinocchio as pin

    model, collision, visual = pin.buildModelsFromUrdf(str(urdf), root_joint=pin.JointModelFreeFlyer())
    assert (model.njoints, len(collision.geometryObjects), len(visual.geometryObjects)) == (
        MOVING + 2,
        COLLISIONS,
        VISUALS,
    )
    assert sum(inertia.mass for inertia in model.inertias) == pytest.approx(MASS)
    np.testing.assert_array_equal(model.effortLimit[6:], 40.0)
    np.testing.assert_allclose(visual.geometryObjects[0].meshColor, (0.62, 0.27, 0.13, 1.0), atol=1e-6)
    srdf = robot.folder / "srdf" / "guara.srdf"
    pin.loadReferenceConfigurations(model, str(srdf))
    data = model.createData()
    q = model.referenceConfigurations["scan"]
    pin.framesForwardKinematics(model, data, q)
    base = data.oMf[model.getFrameId("base_link")]
    for link, transform in expected.items():
        found = base.actInv(data.oMf[model.getFrameId(link, pin.FrameType.BODY)])
        np.testing.assert_allclose(found.homogeneous, transform, atol=1e-9)
    assert capfd.readouterr().err == ""


def test_viser_by_pinocchio(urdf: Path, capfd: Any) -> None:
    """Pinocchio's visualizer in the browser takes every visual."""
    reader("viser", "view")
    import pinocchio as pin
    from pinocchio.visualize import ViserVisualizer

    model, collision, visual = pin.buildModelsFromUrdf(str(urdf))
    viewer = ViserVisualizer(model, collision, visual)
    viewer.initViewer(host="127.0.0.1", port="18130", open=False)
    try:
        viewer.loadViewerModel()
        viewer.display(pin.neutral(model))
    finally:
        viewer.viewer.stop()
    assert "rror" not in capfd.readouterr().err


def test_yourdfpy(urdf: Path, robot: RobotModel, expected: dict[str, np.ndarray], caplog: Any) -> None:
    """Valid by its own checks; links lie where ours do."""
    model = reader("yourdfpy").URDF.load(str(urdf))
    assert model.validate() and not model.errors
    assert (len(model.link_map), len(model.joint_map), len(model.actuated_joint_names)) == (LINKS, JOINTS, MOVING)
    assert len(model.scene.geometry) == VISUALS
    model.update_cfg(robot.posture("scan"))
    for link, transform in expected.items():
        np.testing.assert_allclose(model.get_transform(link, "base_link"), transform, atol=1e-9)
    assert caplog.records == []


def test_urchin(urdf: Path, robot: RobotModel, expected: dict[str, np.ndarray]) -> None:
    """The successor of urdfpy: transmissions and shapes, and the same poses."""
    model = reader("urchin").URDF.load(str(urdf))
    assert (len(model.links), len(model.actuated_joints), len(model.transmissions)) == (LINKS, MOVING, MOVING)
    assert sum(len(link.visuals) for link in model.links) == VISUALS
    placed = model.link_fk(cfg=robot.posture("scan"), use_names=True)
    for link, transform in expected.items():
        np.testing.assert_allclose(placed[link], transform, atol=1e-9)


@pytest.mark.parametrize("file", ["urdf/guara.urdf", "mjcf/guara.xml"])
def test_mujoco(file: str, robot: RobotModel, expected: dict[str, np.ndarray]) -> None:
    """MuJoCo with the URDF and with the MJCF: the same masses, limits and poses; servos and visuals in the MJCF."""
    mujoco = reader("mujoco", "sim")
    model = mujoco.MjModel.from_xml_path(str(robot.folder / file))
    data = mujoco.MjData(model)
    is_mjcf = file.startswith("mjcf")
    assert model.body_mass.sum() == pytest.approx(MASS)
    assert (model.nu, model.ngeom) == ((MOVING, VISUALS + COLLISIONS) if is_mjcf else (0, COLLISIONS))
    for name, low, high in zip(robot.joint_names, robot.tree.lower_limits, robot.tree.upper_limits, strict=True):
        np.testing.assert_allclose(model.joint(name).range, (low, high), atol=1e-9)
        data.joint(name).qpos[0] = robot.posture("scan")[name]
    mujoco.mj_forward(model, data)
    base = np.eye(4)
    if is_mjcf:
        base[:3, :3], base[:3, 3] = data.body("base_link").xmat.reshape(3, 3), data.body("base_link").xpos
    for link, transform in expected.items():
        if not is_mjcf and link == "base_link":
            continue
        found = data.body(link)
        # MuJoCo writes six digits.
        np.testing.assert_allclose(found.xpos, (base @ transform)[:3, 3], atol=3e-6)
        np.testing.assert_allclose(found.xmat.reshape(3, 3), (base @ transform)[:3, :3], atol=3e-6)


def test_drake(robot: RobotModel, expected: dict[str, np.ndarray], caplog: Any) -> None:
    """Drake, by `package://`: an actuator on every joint with its limit, the mass, the poses; no warning."""
    reader("pydrake")
    from pydrake.multibody.parsing import Parser
    from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
    from pydrake.systems.framework import DiagramBuilder

    plant, _ = AddMultibodyPlantSceneGraph(DiagramBuilder(), 0.001)
    parser = Parser(plant)
    parser.package_map().PopulateFromFolder(str(robot.folder.parent))
    parser.AddModels(url="package://guara_description/urdf/guara.urdf")
    plant.Finalize()
    context = plant.CreateDefaultContext()
    assert plant.num_actuators() == MOVING and plant.CalcTotalMass(context) == pytest.approx(MASS)
    for name, low, high in zip(robot.joint_names, robot.tree.lower_limits, robot.tree.upper_limits, strict=True):
        joint = plant.GetJointByName(name)
        assert (joint.position_lower_limit(), joint.position_upper_limit()) == (low, high)
        assert plant.GetJointActuatorByName(name.replace("_joint", "_motor")).effort_limit() == 40.0
        joint.set_angle(context, robot.posture("scan")[name])
    base = plant.GetFrameByName("base_link")
    for link, transform in expected.items():
        found = plant.GetFrameByName(link).CalcPose(context, base).GetAsMatrix4()
        np.testing.assert_allclose(found, transform, atol=1e-9)
    assert caplog.records == []


def test_pybullet(urdf: Path, robot: RobotModel, expected: dict[str, np.ndarray], capfd: Any) -> None:
    """PyBullet gives links without mass one kilogram and says so; with the two lines of the docs the mass is right."""
    bullet = reader("pybullet")
    client = bullet.connect(bullet.DIRECT)
    try:
        body = bullet.loadURDF(str(urdf))
        said = capfd.readouterr()
        assert (said.out + said.err).count("No inertial data for link") == MASSLESS
        links = {bullet.getJointInfo(body, i)[12].decode(): i for i in range(bullet.getNumJoints(body))}
        assert len(links) == LINKS - 1 and len(bullet.getVisualShapeData(body)) == VISUALS

        def mass() -> float:
            return sum(bullet.getDynamicsInfo(body, link)[0] for link in (-1, *links.values()))

        assert mass() == pytest.approx(MASS + MASSLESS)
        for name, link in links.items():
            if not robot.tree.links[name].mass:
                bullet.changeDynamics(body, link, mass=0)
        assert mass() == pytest.approx(MASS)
        for i in links.values():
            joint = bullet.getJointInfo(body, i)[1].decode()
            if joint in robot.joint_names:
                bullet.resetJointState(body, i, robot.posture("scan")[joint])
        for name, link in links.items():
            position = bullet.getLinkState(body, link, computeForwardKinematics=True)[4]
            np.testing.assert_allclose(position, expected[name][:3, 3], atol=1e-6)
    finally:
        bullet.disconnect(client)


def test_rerun(urdf: Path, tmp_path: Path) -> None:
    """Rerun's reader knows every joint and draws every visual."""
    rerun = reader("rerun", "rerun")
    from rerun.urdf import UrdfTree

    tree = UrdfTree.from_file_path(str(urdf))
    assert tree.name == "guara" and len(tree.joints()) == JOINTS
    stream = rerun.RecordingStream("guara_test")
    stream.save(str(tmp_path / "guara.rrd"))
    stream.log_file_from_path(str(urdf))
    stream.flush()
    stream.disconnect()
    command = [sys.executable, "-m", "rerun", "rrd", "print", "-v", tmp_path / "guara.rrd"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    entities = {word for word in done.stdout.split() if word.startswith("/guara/visual_geometries/")}
    assert len({word for word in entities if "/visual_" in word and "@" not in word}) == VISUALS
