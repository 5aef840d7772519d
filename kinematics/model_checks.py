"""Checks that need the whole robot folder: chains, soles, mirror images and the heights of postures."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from kinematics.arrays import Float
from kinematics.exceptions import RobotFileError
from kinematics.robot_toml import LegConfig, PostureConfig
from kinematics.srdf import Posture
from kinematics.state import RobotState
from kinematics.tree import KinematicTree
from kinematics.urdf import Joint, Shape

# Heights in robot.toml are written to the millimetre.
HEIGHT_TOLERANCE = 0.0005

# Mirrored values are written with the same digits on both sides.
MIRROR_TOLERANCE = 1e-6


def check_model(tree: KinematicTree, postures: Mapping[str, Posture]) -> None:
    """Check legs and postures of a robot.

    Raises:
        RobotFileError: naming file, leg or posture, what was found and what is stated.
    """
    try:
        for leg in tree.legs.values():
            _check_chain(tree, leg)
            _check_sole(tree, leg)
        _check_mirrors(tree)
    except RobotFileError as error:
        raise RobotFileError(f"{tree.config.path}: {error}") from None
    for config in tree.config.postures:
        if config.name not in postures:
            raise RobotFileError(
                f"{tree.config.path}: [postures.{config.name}]: the SRDF has no such group_state; "
                f"it has: {', '.join(postures) or 'none'}"
            )
        try:
            _check_posture(tree, config, postures[config.name])
        except RobotFileError as error:
            raise RobotFileError(f"{tree.config.path}: [postures.{config.name}]: {error}") from None


def _path_to_base(tree: KinematicTree, link: str) -> list[Joint]:
    """Joints from the base to a link."""
    above = {joint.child: joint for joint in tree.urdf.joints}
    path: list[Joint] = []
    while link in above:
        path.insert(0, above[link])
        link = above[link].parent
    return path


def _check_chain(tree: KinematicTree, leg: LegConfig) -> None:
    path = _path_to_base(tree, leg.sole)
    moving = tuple(joint.name for joint in path if joint.kind != "fixed")
    if moving != leg.joints:
        raise RobotFileError(
            f"[legs.{leg.name}] joints are {', '.join(leg.joints)}; "
            f"the URDF leads to {leg.sole!r} by {', '.join(moving)}"
        )
    if leg.hip not in [joint.child for joint in path]:
        raise RobotFileError(f"[legs.{leg.name}] hip {leg.hip!r} is not on the way to {leg.sole!r}")


def _check_sole(tree: KinematicTree, leg: LegConfig) -> None:
    """The sole of robot.toml may not be larger than the foot of the URDF."""
    path = _path_to_base(tree, leg.sole)
    transform = np.eye(4)
    lowest, highest = np.full(2, np.inf), np.full(2, -np.inf)
    link = leg.sole
    for joint in reversed(path):
        for shape in tree.links[link].shapes:
            centre, half = _bounds(np.linalg.inv(transform) @ shape.transform_shape_to_link, shape)
            lowest, highest = (
                np.minimum(lowest, (centre - half)[:2]),
                np.maximum(highest, (centre + half)[:2]),
            )
        if joint.kind != "fixed":
            break
        # Of the sole in the link above: what follows asks for shapes in the frame of the sole.
        transform, link = joint.transform_child_to_parent @ transform, joint.parent
    if not np.all(np.isfinite(lowest)):
        raise RobotFileError(f"[legs.{leg.name}]: the foot of {leg.sole!r} has no <collision> shape")
    for axis, name, size in ((0, "length", tree.config.sole[0]), (1, "width", tree.config.sole[1])):
        found = 2.0 * min(-lowest[axis], highest[axis])
        if size > found + HEIGHT_TOLERANCE:
            raise RobotFileError(
                f"sole {name} is {size:g} m, but the collision shapes of the foot of leg {leg.name!r} "
                f"reach only {found:.4g} m about {leg.sole!r}"
            )


def _bounds(transform: Float, shape: Shape) -> tuple[Float, Float]:
    """Centre and half extents of a shape's bounding box, along the axes that `transform` leads to."""
    if shape.kind == "box":
        half = np.asarray(shape.size) / 2.0
    elif shape.kind == "cylinder":
        half = np.array([shape.size[0], shape.size[0], shape.size[1] / 2.0])
    else:
        return transform[:3, 3], np.full(3, shape.size[0])
    return transform[:3, 3], np.abs(transform[:3, :3]) @ half


def _check_mirrors(tree: KinematicTree) -> None:
    """Every leg has a mirror image on the other side: same joints, limits, lengths, masses and shapes."""
    hips = {name: _hip(tree, leg) for name, leg in tree.legs.items()}
    for name, leg in tree.legs.items():
        image = hips[name] * (1.0, -1.0, 1.0)
        twins = [
            other for other, hip in hips.items() if other != name and np.allclose(hip, image, atol=MIRROR_TOLERANCE)
        ]
        if len(twins) != 1:
            raise RobotFileError(
                f"[legs.{name}]: its hip is at {_text(hips[name])}; no leg has its hip at the mirror image "
                f"{_text(image)}"
            )
        _check_twins(tree, leg, tree.legs[twins[0]])


def _hip(tree: KinematicTree, leg: LegConfig) -> Float:
    transform = np.eye(4)
    for joint in _path_to_base(tree, leg.hip):
        transform = transform @ joint.transform_child_to_parent
    return np.asarray(transform[:3, 3])


def _check_twins(tree: KinematicTree, leg: LegConfig, twin: LegConfig) -> None:
    mirror = np.diag([1.0, -1.0, 1.0])
    ours, theirs = _path_to_base(tree, leg.sole), _path_to_base(tree, twin.sole)
    if len(ours) != len(theirs):
        raise RobotFileError(
            f"legs {leg.name!r} and {twin.name!r} are no mirror images: {len(ours)} and {len(theirs)} joints"
        )
    for a, b in zip(ours, theirs, strict=True):
        pair = f"joints {a.name!r} and {b.name!r} are no mirror images"
        image = a.transform_child_to_parent.copy()
        image[:3, :3] = mirror @ image[:3, :3] @ mirror
        image[:3, 3] = mirror @ image[:3, 3]
        if not np.allclose(image, b.transform_child_to_parent, atol=MIRROR_TOLERANCE):
            raise RobotFileError(
                f"{pair}: origins {_text(a.transform_child_to_parent[:3, 3])} and "
                f"{_text(b.transform_child_to_parent[:3, 3])}, or their rotations"
            )
        if a.kind != "fixed":
            _check_limits(a, b, mirror, pair)
        first, second = tree.links[a.child], tree.links[b.child]
        if (first.mass or 0.0) != (second.mass or 0.0) or not np.allclose(
            mirror @ first.inertia @ mirror, second.inertia, rtol=1e-6, atol=0.0
        ):
            raise RobotFileError(f"links {first.name!r} and {second.name!r} are no mirror images: mass or inertia")
        if [shape.size for shape in first.shapes] != [shape.size for shape in second.shapes]:
            raise RobotFileError(f"links {first.name!r} and {second.name!r} are no mirror images: collision shapes")


def _check_limits(a: Joint, b: Joint, mirror: Float, pair: str) -> None:
    # A mirror keeps the sense of turns about an axis across it and reverses others; a slide just mirrors.
    image = mirror @ a.axis if a.kind == "prismatic" else -mirror @ a.axis
    sense = float(image @ b.axis)
    limits = (a.lower, a.upper) if sense > 0.0 else (-a.upper, -a.lower)
    if a.kind != b.kind or abs(abs(sense) - 1.0) > 1e-3 or not np.allclose(limits, (b.lower, b.upper)):
        raise RobotFileError(
            f"{pair}: axis {_text(a.axis)} with limits {a.lower:g} ... {a.upper:g}, "
            f"axis {_text(b.axis)} with {b.lower:g} ... {b.upper:g}"
        )


def _check_posture(tree: KinematicTree, config: PostureConfig, posture: Posture) -> None:
    for index, joint in enumerate(tree.joint_names):
        value, lower, upper = (
            posture.joint_positions[joint],
            tree.lower_limits[index],
            tree.upper_limits[index],
        )
        if not lower <= value <= upper:
            raise RobotFileError(f"joint {joint!r} is at {value:g}, outside its limits {lower:g} ... {upper:g}")
    state = RobotState(tree, posture.joint_positions)
    soles = state.soles_in_base()
    floor = float(soles[:, 2].mean())
    for leg, sole in zip(tree.legs, soles, strict=True):
        if abs(sole[2] - floor) > HEIGHT_TOLERANCE:
            raise RobotFileError(f"the sole of {leg!r} is {1e3 * (sole[2] - floor):+.1f} mm off the plane of all soles")
    for name, leg_config in tree.legs.items():
        _compare(f"hip_height of {name!r}", state.position_in_base(leg_config.hip)[2] - floor, config.hip_height)
    camera = state.position_in_base(tree.config.camera_frame)[2] - floor
    _compare("camera_height", camera, config.camera_height)
    if posture.root is not None:
        _compare("root_joint z of the SRDF", posture.root[2], -floor)


def _compare(what: str, found: float, stated: float) -> None:
    if abs(found - stated) > HEIGHT_TOLERANCE:
        raise RobotFileError(f"{what} comes out at {found:.4f} m, but {stated:.4f} m is stated")


def _text(values: Iterable[float]) -> str:
    return "(" + ", ".join(f"{value:g}" for value in values) + ")"
