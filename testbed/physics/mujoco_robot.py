"""MuJoCo model and MJCF file of a robot, from its URDF, with a free base and a position servo on every joint."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

from guara_perception.exceptions import InvalidInput, optional_library
from kinematics import Stance
from kinematics.srdf import allowed_pairs

if TYPE_CHECKING:
    from kinematics import RobotModel

# With MuJoCo's default pyramidal cone, feet creep by 2.6 mm per swing; with a time step of 4 ms, they slide by 150 mm.
STEP_S = 0.002
FRICTION = (0.9, 0.01, 0.001)
IMPEDANCE_RATIO = 10.0
# A stiffer servo (1000) vibrates, and a softer one sags.
SERVO_STIFFNESS = 300.0
SERVO_DAMPING = 12.0
# Groups of shapes: MuJoCo's viewer shows visuals and hides collision shapes.
VISUAL_GROUP, COLLISION_GROUP = 2, 3
SOLID_COLOUR = (0.5, 0.5, 0.5, 1.0)


def mujoco_robot(robot: RobotModel, *, with_visuals: bool = False) -> Any:
    """Create a `mujoco.MjSpec` of a robot with a free base and a position servo per joint, which has the joint's name.

    Args:
        robot: robot whose URDF is read.
        with_visuals: True = keep visual shapes too.

    Raises:
        MissingExtra: MuJoCo is not installed.
        InvalidInput: MuJoCo rejects the URDF.
    """
    mujoco = optional_library("mujoco", "sim", "a robot in MuJoCo")
    try:
        spec = mujoco.MjSpec.from_string(_for_mujoco(robot.tree.urdf.text, with_visuals=with_visuals))
        spec.body(robot.config.base_frame).add_freejoint()
        for geom in spec.geoms:
            # Only visuals have colours; MuJoCo's reader gives collision shapes the last colour that it has read.
            is_solid = bool(geom.contype)
            geom.group = COLLISION_GROUP if is_solid else VISUAL_GROUP
            if is_solid:
                geom.friction, geom.rgba = FRICTION, SOLID_COLOUR
        for name in robot.joint_names:
            servo = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
            servo.set_to_position(kp=SERVO_STIFFNESS, kv=SERVO_DAMPING)
            limit = float(spec.joint(name).actfrcrange[1])
            if limit > 0.0:
                servo.forcelimited, servo.forcerange = True, [-limit, limit]
        option = spec.option
        option.timestep, option.impratio = STEP_S, IMPEDANCE_RATIO
        option.cone, option.integrator = mujoco.mjtCone.mjCONE_ELLIPTIC, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        spec.compile()
    except ValueError as error:
        raise InvalidInput(f"{robot.tree.urdf.path}: MuJoCo rejects the URDF: {error}") from None
    return spec


def mjcf(robot: RobotModel) -> str:
    """Return the MJCF text of a robot, with visuals, servos limited to the joint ranges, and postures as keyframes.

    Raises:
        MissingExtra: MuJoCo is not installed.
        InvalidInput: MuJoCo rejects the URDF.
    """
    mujoco = optional_library("mujoco", "sim", "an MJCF file")
    spec = mujoco_robot(robot, with_visuals=True)
    for joint in robot.joint_names:
        servo = spec.actuator(joint)
        servo.ctrllimited, servo.ctrlrange = True, spec.joint(joint).range
    for one, other in allowed_pairs(robot.folder / "srdf" / f"{robot.name}.srdf"):
        spec.add_exclude(bodyname1=one, bodyname2=other)
    model = spec.compile()
    for name in robot.posture_names:
        positions = robot.posture(name)
        data = mujoco.MjData(model)
        data.qpos[:3] = robot.stance_pose(Stance(positions, robot.legs)).transform_base_to_footprint[:3, 3]
        for joint, position in positions.items():
            data.joint(joint).qpos[0] = data.actuator(joint).ctrl[0] = position
        spec.add_key(name=name, qpos=data.qpos, ctrl=data.ctrl)
    spec.compile()
    head = "<!-- Generated from the URDF by `python -m testbed.physics`; edit the URDF instead. -->"
    return f"{head}\n{_for_all_versions(spec.to_xml())}"


def _for_mujoco(urdf: str, *, with_visuals: bool) -> str:
    """Add options to a URDF so that MuJoCo keeps links without mass and, if requested, visuals."""
    root = ElementTree.fromstring(urdf)
    for found in root.findall("mujoco"):
        root.remove(found)
    attributes = {"fusestatic": "false", "discardvisual": str(not with_visuals).lower()}
    ElementTree.SubElement(ElementTree.SubElement(root, "mujoco"), "compiler", attributes)
    return ElementTree.tostring(root, encoding="unicode")


def _for_all_versions(text: str) -> str:
    """Rewrite servos in an MJCF text as <position>, because MuJoCo 4 writes attributes that MuJoCo 3 does not know."""
    root = ElementTree.fromstring(text)
    kept = ("name", "joint", "ctrlrange", "forcerange")
    for servo in root.iter("general"):
        attributes = {str(name): value for name, value in servo.attrib.items() if name in kept}
        servo.tag = "position"
        servo.attrib.clear()
        servo.attrib.update(attributes | {"kp": f"{SERVO_STIFFNESS:g}", "kv": f"{SERVO_DAMPING:g}"})
    return ElementTree.tostring(root, encoding="unicode") + "\n"
