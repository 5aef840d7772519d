"""Consistency checks of a URDF: unique names, a single tree, valid limits and axes, and a mass.

Each of the faults found here is accepted silently by at least one of urdfdom's check_urdf, Pinocchio, MuJoCo and
yourdfpy.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from kinematics.findings import Findings
from kinematics.urdf import Joint, Urdf

# Tolerance of the length of an axis, for components written with three decimals.
AXIS_TOLERANCE = 1e-3
# Largest number of moving joints, which is the limit of the messages that announce a stance. A chain of 3,000 joints
# would take minutes and 700 MB to load.
MOST_JOINTS = 256


def check_urdf(urdf: Urdf, root: str | None = None) -> None:
    """Check names, the tree of links, every moving joint and the masses of a URDF.

    Args:
        urdf: content of the file.
        root: link that must be the root of the tree; None = any link.

    Raises:
        RobotFileError: there are faults; the message lists those found, each with the file and, if known, the line.
    """
    findings = Findings(urdf.path)
    moving = sum(joint.kind != "fixed" for joint in urdf.joints)
    if moving > MOST_JOINTS:
        findings.wrong(f"{moving} joints move; allowed: up to {MOST_JOINTS}. Make those that carry no foot fixed")
        findings.refuse()
    _check_names(urdf, findings)
    if not findings.is_wrong:
        _check_tree(urdf, root, findings)
    for joint in urdf.joints:
        if joint.kind != "fixed":
            _check_joint(joint, findings)
    if not any(link.mass for link in urdf.links):
        findings.wrong("no link has a mass: the robot's balance cannot be computed; give the links an <inertial>")
    findings.refuse()


def root_link(urdf: Urdf) -> str:
    """Name of the link that is not the child of any joint: the first if there are several, empty if there is none."""
    children = {joint.child for joint in urdf.joints}
    return next((link.name for link in urdf.links if link.name not in children), "")


def _repeated(named: Iterable[tuple[str, int]]) -> list[tuple[str, int]]:
    seen: set[str] = set()
    twice = []
    for name, line in named:
        if name in seen:
            twice.append((name, line))
        seen.add(name)
    return twice


def _check_names(urdf: Urdf, findings: Findings) -> None:
    for name, line in _repeated((link.name, link.line) for link in urdf.links):
        findings.wrong(f"link {name!r} is defined twice", line)
    for name, line in _repeated((joint.name, joint.line) for joint in urdf.joints):
        findings.wrong(f"joint {name!r} is defined twice", line)
    for name, line in _repeated((joint.child, joint.line) for joint in urdf.joints):
        findings.wrong(f"link {name!r} is the child of two joints; allowed: one", line)
    links = {link.name for link in urdf.links}
    for joint in urdf.joints:
        for role, name in (("parent", joint.parent), ("child", joint.child)):
            if name not in links:
                findings.wrong(f"joint {joint.name!r}: {role} link {name!r} is not defined in this file", joint.line)


def _check_tree(urdf: Urdf, root: str | None, findings: Findings) -> None:
    children = {joint.child for joint in urdf.joints}
    roots = [link.name for link in urdf.links if link.name not in children]
    if len(roots) > 1:
        findings.wrong(
            f"two or more roots: {', '.join(repr(name) for name in roots)}; "
            f"every link but {root or roots[0]!r} must be the child of a joint"
        )
        return
    if not roots or (root is not None and roots != [root]):
        given = repr(roots[0]) if roots else "missing: the joints form a loop"
        findings.wrong(f"the root is {given}" + (f"; robot.toml names {root!r} as frames.base" if root else ""))
        return
    parents = {joint.child: joint.parent for joint in urdf.joints}
    for link in urdf.links:
        name, links_passed = link.name, 0
        while name in parents and links_passed <= len(urdf.links):
            name, links_passed = parents[name], links_passed + 1
        if name != roots[0]:
            findings.wrong(f"link {link.name!r} is in a loop of joints, not connected to {roots[0]!r}", link.line)


def _listed(values: Iterable[float]) -> str:
    return "(" + ", ".join(f"{value:.4g}" for value in values) + ")"


def _check_joint(joint: Joint, findings: Findings) -> None:
    where = f"joint {joint.name!r}"
    length = float(np.linalg.norm(joint.axis))
    if length == 0.0:
        findings.wrong(f"{where}: the axis is zero; a unit vector is needed", joint.line)
    elif abs(length - 1.0) > AXIS_TOLERANCE:
        findings.wrong(
            f"{where}: the axis {_listed(joint.axis)} has length {length:.4g}; it must be a unit vector", joint.line
        )
    if not joint.lower < joint.upper:
        findings.wrong(
            f"{where}: the lower limit {joint.lower:g} is not below the upper limit {joint.upper:g}", joint.line
        )
