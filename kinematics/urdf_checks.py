"""Checks of a URDF that no single reader makes: one tree, sound limits, axes and inertias.

Each of these faults was found to pass at least one of check_urdf, Pinocchio, MuJoCo and yourdfpy without a
word.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from kinematics.exceptions import RobotFileError
from kinematics.urdf import Joint, Link, Urdf

# An axis written with three decimals.
AXIS_TOLERANCE = 1e-3
# Of the largest moment: figures rounded to seven digits.
TRIANGLE_TOLERANCE = 1e-6


def check_urdf(urdf: Urdf, root: str) -> None:
    """Check the tree, every link and every joint.

    Args:
        urdf: what was read.
        root: the link that must be the root of the tree.

    Raises:
        RobotFileError: naming file, link or joint, what was given and what is allowed.
    """
    try:
        _check_tree(urdf, root)
        moved = {joint.child for joint in urdf.joints if joint.kind != "fixed"} | {root}
        for link in urdf.links:
            _check_inertia(link, moves=link.name in moved)
        for joint in urdf.joints:
            if joint.kind != "fixed":
                _check_joint(joint)
    except RobotFileError as error:
        raise RobotFileError(f"{urdf.path}: {error}") from None


def _repeated(names: Iterable[str]) -> str | None:
    seen: set[str] = set()
    for name in names:
        if name in seen:
            return name
        seen.add(name)
    return None


def _check_tree(urdf: Urdf, root: str) -> None:
    links = {link.name for link in urdf.links}
    if (name := _repeated(link.name for link in urdf.links)) is not None:
        raise RobotFileError(f"link {name!r} is defined twice")
    if (name := _repeated(joint.name for joint in urdf.joints)) is not None:
        raise RobotFileError(f"joint {name!r} is defined twice")
    if (name := _repeated(joint.child for joint in urdf.joints)) is not None:
        raise RobotFileError(f"link {name!r} is the child of two joints; every link hangs on one")
    for joint in urdf.joints:
        for role, name in (("parent", joint.parent), ("child", joint.child)):
            if name not in links:
                raise RobotFileError(f"joint {joint.name!r}: {role} link {name!r} is not defined in this file")
    children = {joint.child for joint in urdf.joints}
    roots = [link.name for link in urdf.links if link.name not in children]
    if len(roots) > 1:
        raise RobotFileError(
            f"two or more roots: {', '.join(repr(name) for name in roots)}; "
            f"every link but {root!r} must be the child of a joint"
        )
    if roots != [root]:
        given = repr(roots[0]) if roots else "a circle of joints"
        raise RobotFileError(f"the root is {given}; robot.toml names {root!r} as frames.base")
    parents = {joint.child: joint.parent for joint in urdf.joints}
    for link in links:
        name, steps = link, 0
        while name in parents and steps <= len(links):
            name, steps = parents[name], steps + 1
        if name != root:
            raise RobotFileError(f"link {link!r} hangs in a circle of joints, not on {root!r}")


def _check_inertia(link: Link, *, moves: bool) -> None:
    where = f"link {link.name!r}"
    if link.mass is None:
        if moves:
            raise RobotFileError(f"{where}: moves, but has no <inertial>; mass > 0 is needed")
        return
    if not link.mass > 0.0:
        raise RobotFileError(f"{where}: mass is {link.mass:g} kg; it must be positive")
    moments = np.linalg.eigvalsh(link.inertia)
    if not moments[0] > 0.0:
        raise RobotFileError(f"{where}: principal moments of inertia are {_listed(moments)}; all must be positive")
    if moments[0] + moments[1] < moments[2] * (1.0 - TRIANGLE_TOLERANCE):
        raise RobotFileError(
            f"{where}: principal moments of inertia {_listed(moments)} kg m^2 belong to no body: "
            "the largest may not exceed the sum of the others"
        )


def _listed(values: Iterable[float]) -> str:
    return "(" + ", ".join(f"{value:.4g}" for value in values) + ")"


def _check_joint(joint: Joint) -> None:
    where = f"joint {joint.name!r}"
    length = float(np.linalg.norm(joint.axis))
    if length == 0.0:
        raise RobotFileError(f"{where}: the axis is zero; a unit vector is needed")
    if abs(length - 1.0) > AXIS_TOLERANCE:
        raise RobotFileError(
            f"{where}: the axis {_listed(joint.axis)} has length {length:.4g}; it must be a unit vector"
        )
    if not joint.lower < joint.upper:
        raise RobotFileError(f"{where}: the lower limit {joint.lower:g} is not below the upper limit {joint.upper:g}")
