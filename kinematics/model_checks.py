"""Checks across the files of a robot folder: names, leg chains, soles, left-right pairs, heights of postures."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from kinematics.arrays import Float
from kinematics.findings import Findings
from kinematics.robot_toml import LegConfig, PostureConfig, RobotToml
from kinematics.srdf import Posture
from kinematics.tree import KinematicTree, RobotState
from kinematics.urdf import Joint, Shape, Urdf

# Tolerance of heights and sole sizes [m], which robot.toml states to the millimetre.
HEIGHT_TOLERANCE = 0.0005

# Tolerance of differences between left and right legs [m]; a larger difference is a mistake in the file.
PAIR_TOLERANCE = 0.0005

# Largest accepted difference in height between a sole frame and the lowest point of its foot [m]. Every foothold is
# wrong by this difference: by 4 mm, for example, on a round foot of radius 20 mm if the frame is aligned with a shank
# tilted by 37 degrees.
SOLE_TOLERANCE = 0.005


def check_names(config: RobotToml, urdf: Urdf, findings: Findings) -> None:
    """Check that the URDF has every link and every moving joint named in [frames] and [legs.<name>] of robot.toml.

    An empty link name, which stands for an optional or invalid entry, is skipped.
    """
    links = [link.name for link in urdf.links]
    moving = [joint.name for joint in urdf.joints if joint.kind != "fixed"]
    frames = {
        "frames.base": config.base_frame,
        "frames.camera": config.camera_frame,
        "frames.laser": config.laser_frame,
        "frames.imu": config.imu_frame or "",
    }
    frames |= {f"legs.{leg.name}.{end}": getattr(leg, end) for leg in config.legs for end in ("hip", "sole")}
    for key, frame in frames.items():
        if frame and frame not in links:
            findings.wrong(
                f"{key} is {frame!r}, which is not a link of {urdf.path.name}; its links are: {', '.join(links)}",
                config.root.line(key),
            )
    for leg in config.legs:
        for joint in leg.joints:
            if joint not in moving:
                findings.wrong(
                    f"[legs.{leg.name}] joints contains {joint!r}, which is not a moving joint of {urdf.path.name}; "
                    f"its moving joints are: {', '.join(moving)}",
                    config.root.line(f"legs.{leg.name}.joints"),
                )


def check_legs(tree: KinematicTree, findings: Findings) -> None:
    """Check chains, soles and left-right pairs of the legs; soles and pairs only if all chains are correct.

    The sole size of a foot without collision shapes cannot be checked; this is noted.
    """
    before = len(findings.texts)
    for leg in tree.legs.values():
        _check_chain(tree, leg, findings)
    if len(findings.texts) > before:
        return
    for leg in tree.legs.values():
        _check_sole_size(tree, leg, findings)
    _check_pairs(tree, findings)


def check_postures(tree: KinematicTree, postures: Mapping[str, Posture], findings: Findings) -> None:
    """Check every posture of robot.toml against URDF and SRDF: limits, heights of soles, hips, camera and root."""
    for config in tree.config.postures:
        if config.name in postures:
            _check_posture(tree, config, postures[config.name], findings)
        else:
            findings.wrong(
                f"[postures.{config.name}]: the SRDF has no such group_state; it has: {', '.join(postures) or 'none'}",
                tree.config.root.line(f"postures.{config.name}"),
            )


def _check_chain(tree: KinematicTree, leg: LegConfig, findings: Findings) -> None:
    path = tree.urdf.path_to(leg.sole)
    moving = tuple(joint.name for joint in path if joint.kind != "fixed")
    if moving != leg.joints:
        findings.wrong(
            f"[legs.{leg.name}] joints are {', '.join(leg.joints)}; "
            f"the chain to {leg.sole!r} in the URDF is {', '.join(moving)}: list these, in this order",
            tree.config.root.line(f"legs.{leg.name}.joints"),
        )
    links = [joint.child for joint in path]
    if leg.hip not in links:
        findings.wrong(
            f"[legs.{leg.name}] hip {leg.hip!r} is not in the chain to {leg.sole!r}; allowed: {', '.join(links)}",
            tree.config.root.line(f"legs.{leg.name}.hip"),
        )


def frames_fixed_to(urdf: Urdf, link: str, transform: Float | None = None) -> Iterator[tuple[str, Float]]:
    """Iterate over a link and all links fixed to it further down the tree, each with its transform (4, 4) to that link.

    If `transform` (4, 4) from the link to another frame is given, all transforms lead to that frame instead.
    """
    open_links = [(link, np.eye(4) if transform is None else transform)]
    while open_links:
        name, to_link = open_links.pop()
        yield name, to_link
        fixed = (joint for joint in urdf.joints if joint.kind == "fixed" and joint.parent == name)
        open_links += [(joint.child, to_link @ joint.transform_child_to_parent) for joint in fixed]


def foot_shapes(tree: KinematicTree, leg: LegConfig) -> list[tuple[Shape, Float]]:
    """Collision shapes rigidly connected to a sole, each with transform_shape_to_sole (4, 4)."""
    # Go up to the link carried by the last moving joint, then down to everything fixed to that link.
    to_sole, link = np.eye(4), leg.sole
    for joint in reversed(tree.urdf.path_to(leg.sole)):
        if joint.kind != "fixed":
            break
        to_sole, link = to_sole @ np.linalg.inv(joint.transform_child_to_parent), joint.parent
    return [
        (shape, transform @ shape.transform_shape_to_link)
        for name, transform in frames_fixed_to(tree.urdf, link, to_sole)
        for shape in tree.links[name].shapes
    ]


def extent_along(shape: Shape, rotation: Float, direction: Float) -> float:
    """Extent of a shape, rotated by `rotation` (3, 3), from its centre along a unit vector (3,) [m]."""
    along = np.abs(rotation.T @ direction)
    if shape.kind == "box":
        return float(along @ np.asarray(shape.size) / 2.0)
    if shape.kind == "cylinder":
        return float(shape.size[0] * np.hypot(along[0], along[1]) + along[2] * shape.size[1] / 2.0)
    return float(shape.size[0])


def _check_sole_size(tree: KinematicTree, leg: LegConfig, findings: Findings) -> None:
    """Check that the sole of robot.toml is not larger than the foot of the URDF."""
    shapes = foot_shapes(tree, leg)
    if not shapes:
        findings.unused(f"[legs.{leg.name}]: the foot of {leg.sole!r} has no <collision> shape to check")
        return
    for axis, name, size in ((0, "length", tree.config.sole[0]), (1, "width", tree.config.sole[1])):
        direction = np.eye(3)[axis]
        extents = [(m[axis, 3], extent_along(shape, m[:3, :3], direction)) for shape, m in shapes]
        found = 2.0 * min(max(reach - centre for centre, reach in extents), max(c + r for c, r in extents))
        if size > found + HEIGHT_TOLERANCE:
            findings.wrong(
                f"sole {name} is {size:g} m, but the collision shapes of the foot of leg {leg.name!r} "
                f"cover only {found:.4g} m around {leg.sole!r}: correct the stated size or the shapes",
                tree.config.root.line("sole"),
            )


def _check_pairs(tree: KinematicTree, findings: Findings) -> None:
    """Check that every leg has one mirror image: mirrored hip, equal lengths from joint to joint, and mirrored limits.

    Names, axes and masses may differ between the sides.
    """
    hips = {name: tree.urdf.transform_at_zero(leg.hip)[:3, 3] for name, leg in tree.legs.items()}
    for name, leg in tree.legs.items():
        image = hips[name] * (1.0, -1.0, 1.0)
        twins = [other for other, hip in hips.items() if other != name and np.allclose(hip, image, atol=PAIR_TOLERANCE)]
        if len(twins) != 1:
            findings.wrong(
                f"[legs.{name}]: its hip is at {_text(hips[name])}; {len(twins) or 'no'} legs have their hip at the "
                f"mirror image {_text(image)}; exactly one must. Correct the origin of the joint that carries the hip",
                tree.config.root.line(f"legs.{name}"),
            )
            continue
        if name > twins[0]:
            continue
        lengths, twin_lengths = _lengths(tree, leg), _lengths(tree, tree.legs[twins[0]])
        if len(lengths) != len(twin_lengths) or not np.allclose(lengths, twin_lengths, atol=PAIR_TOLERANCE):
            findings.wrong(
                f"legs {name!r} and {twins[0]!r} are not mirror images: from joint to joint they measure "
                f"{_text(lengths)} and {_text(twin_lengths)} m: correct the joints' origins",
                tree.config.root.line(f"legs.{name}"),
            )
        else:
            _check_limits(tree, leg, tree.legs[twins[0]], findings)


def _check_limits(tree: KinematicTree, leg: LegConfig, twin: LegConfig, findings: Findings) -> None:
    """Check that paired joints of the same kind have mirrored limits, if their axes mirror each other up to sign."""
    joints = {joint.name: joint for joint in tree.urdf.joints}
    for joint, twin_joint in zip(leg.joints, twin.joints, strict=True):
        a, b = joints[joint], joints[twin_joint]
        # Mirroring in y = 0 keeps rotations about y and reverses rotations about x and z; a sliding axis is mirrored.
        image = _axis(tree, a) * ((1.0, -1.0, 1.0) if a.kind == "prismatic" else (-1.0, 1.0, -1.0))
        sense = float(image @ _axis(tree, b))
        limits = (a.lower, a.upper) if sense > 0.0 else (-a.upper, -a.lower)
        if a.kind == b.kind and abs(sense) > 0.999 and not np.allclose(limits, (b.lower, b.upper), atol=1e-3):
            findings.wrong(
                f"joints {joint!r} and {twin_joint!r} are not mirror images: axis {_text(a.axis)} with limits "
                f"{a.lower:g} ... {a.upper:g}, axis {_text(b.axis)} with {b.lower:g} ... {b.upper:g}: "
                "correct limits or axis",
                tree.config.root.line(f"legs.{leg.name}.joints"),
            )


def _axis(tree: KinematicTree, joint: Joint) -> Float:
    """Axis (3,) of a joint in `base_link`, with all joints at zero."""
    return np.asarray(tree.urdf.transform_at_zero(joint.child)[:3, :3] @ joint.axis)


def _lengths(tree: KinematicTree, leg: LegConfig) -> Float:
    """Distances between the origins of successive moving joints of a leg, and from the last one to the sole [m]."""
    lengths, transform = [], np.eye(4)
    for joint in tree.urdf.path_to(leg.sole):
        transform = transform @ joint.transform_child_to_parent
        if joint.kind != "fixed":
            lengths.append(float(np.linalg.norm(transform[:3, 3])))
            transform = np.eye(4)
    return np.array([*lengths[1:], float(np.linalg.norm(transform[:3, 3]))])


def _check_posture(tree: KinematicTree, config: PostureConfig, posture: Posture, findings: Findings) -> None:
    where = f"[postures.{config.name}]"
    line = tree.config.root.line(f"postures.{config.name}")
    for index, joint in enumerate(tree.joint_names):
        value, lower, upper = posture.joint_positions[joint], tree.lower_limits[index], tree.upper_limits[index]
        if not lower <= value <= upper:
            findings.wrong(
                f"{where}: joint {joint!r} is at {value:g}, outside its limits {lower:g} ... {upper:g}: "
                "correct the SRDF, or the limits of the URDF",
                line,
            )
    state = RobotState(tree, posture.joint_positions)
    soles = state.soles_in_base()
    floor = float(soles[:, 2].mean())
    for leg, sole in zip(tree.legs, soles, strict=True):
        if abs(sole[2] - floor) > HEIGHT_TOLERANCE:
            findings.wrong(
                f"{where}: the sole of {leg!r} is {1e3 * (sole[2] - floor):+.1f} mm from the mean height of all soles: "
                "correct its joints in the SRDF",
                line,
            )
    if config.name == tree.config.scan_posture:
        for leg_config in tree.legs.values():
            _check_sole_height(tree, leg_config, state, findings)
    for name, leg_config in tree.legs.items():
        hip = state.position_in_base(leg_config.hip)[2] - floor
        _compare(tree, config, "hip_height", f"hip_height of {name!r}", hip, config.hip_height, findings)
    camera = state.position_in_base(tree.config.camera_frame)[2] - floor
    _compare(tree, config, "camera_height", "camera_height", camera, config.camera_height, findings)
    if posture.root is not None:
        _compare(tree, config, "", "root_joint z of the SRDF", -floor, posture.root[2], findings)


def sole_above_foot(tree: KinematicTree, leg: LegConfig, state: RobotState) -> float | None:
    """Height of a sole frame above the lowest point of the foot's shapes, along base z [m]; None without shapes."""
    sole = state.transform_to_base(leg.sole)
    down = np.array([0.0, 0.0, -1.0])
    depths = [
        extent_along(shape, sole[:3, :3] @ m[:3, :3], down) - float((sole[:3, :3] @ m[:3, 3])[2])
        for shape, m in foot_shapes(tree, leg)
    ]
    return max(depths) if depths else None


def _check_sole_height(tree: KinematicTree, leg: LegConfig, state: RobotState, findings: Findings) -> None:
    above = sole_above_foot(tree, leg, state)
    if above is not None and abs(above) > SOLE_TOLERANCE:
        side = "above" if above > 0.0 else "below"
        findings.wrong(
            f"[legs.{leg.name}] sole: the frame {leg.sole!r} is {1e3 * abs(above):.1f} mm {side} the lowest point "
            "of its foot in the scan posture: move the frame to where the foot touches the ground",
            tree.config.root.line(f"legs.{leg.name}.sole"),
        )


def _compare(
    tree: KinematicTree, config: PostureConfig, key: str, what: str, found: float, stated: float, findings: Findings
) -> None:
    if abs(found - stated) > HEIGHT_TOLERANCE:
        findings.wrong(
            f"[postures.{config.name}]: {what} is {found:.4f} m in the posture, but {stated:.4f} m is stated: "
            "correct the stated value or the posture",
            tree.config.root.line(f"postures.{config.name}" + (f".{key}" if key else "")),
        )


def _text(values: Float) -> str:
    return "(" + ", ".join(f"{value:g}" for value in values) + ")"
