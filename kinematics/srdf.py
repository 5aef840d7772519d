"""Reads the named postures of an SRDF file, refusing names that the URDF does not have."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element

from kinematics.exceptions import RobotFileError
from kinematics.urdf import Urdf
from kinematics.xml_file import read_xml

# The name by which an SRDF places the body: x y z [m] and quaternion x y z w.
ROOT_JOINT = "root_joint"


@dataclass(frozen=True, slots=True)
class Posture:
    """A named posture: position of every joint [rad], and the body's pose (7,) where the file gives it."""

    name: str
    joint_positions: dict[str, float]
    root: tuple[float, ...] | None


def read_srdf(path: Path, urdf: Urdf) -> tuple[Posture, ...]:
    """Read the `group_state` elements of an SRDF file.

    Args:
        path: the file.
        urdf: the model whose joints and links the file may name.

    Raises:
        RobotFileError: no XML, an unknown joint or link, a joint missing, twice or without finite value.
    """
    root, _ = read_xml(path)
    try:
        _check_links(root, urdf)
        postures = tuple(_posture(state, urdf) for state in root.findall("group_state"))
        names = [posture.name for posture in postures]
        for name in names:
            if names.count(name) > 1:
                raise RobotFileError(f"group_state {name!r} is defined {names.count(name)} times")
    except RobotFileError as error:
        raise RobotFileError(f"{path}: {error}") from None
    return postures


def allowed_pairs(path: Path) -> list[tuple[str, str]]:
    """Pairs of links that an SRDF says may touch.

    Raises:
        RobotFileError: the file cannot be read.
    """
    root, _ = read_xml(path)
    return [(str(pair.get("link1")), str(pair.get("link2"))) for pair in root.iter("disable_collisions")]


def _check_links(root: Element, urdf: Urdf) -> None:
    links = {link.name for link in urdf.links}
    for element, attributes in (
        ("disable_collisions", ("link1", "link2")),
        ("chain", ("base_link", "tip_link")),
    ):
        for found in root.iter(element):
            for attribute in attributes:
                if found.get(attribute) not in links:
                    raise RobotFileError(
                        f"<{element}>: {attribute} {found.get(attribute)!r} is no link of {urdf.path.name}"
                    )


def _posture(state: Element, urdf: Urdf) -> Posture:
    name = state.get("name") or ""
    where = f"group_state {name!r}"
    moving = [joint.name for joint in urdf.joints if joint.kind != "fixed"]
    positions: dict[str, float] = {}
    root: tuple[float, ...] | None = None
    for element in state.findall("joint"):
        joint = element.get("name") or ""
        values = _numbers(element.get("value"), f"{where}: joint {joint!r}")
        if joint == ROOT_JOINT:
            if len(values) != 7:
                raise RobotFileError(
                    f"{where}: {ROOT_JOINT} has {len(values)} numbers; seven are needed (x y z qx qy qz qw)"
                )
            root = values
            continue
        if joint not in moving:
            raise RobotFileError(f"{where}: unknown joint {joint!r}; {urdf.path.name} has: {', '.join(moving)}")
        if joint in positions or len(values) != 1:
            raise RobotFileError(f"{where}: joint {joint!r} needs one value, once")
        positions[joint] = values[0]
    missing = [joint for joint in moving if joint not in positions]
    if missing:
        raise RobotFileError(f"{where}: no value for {', '.join(missing)}")
    return Posture(name, positions, root)


def _numbers(text: str | None, where: str) -> tuple[float, ...]:
    try:
        values = tuple(float(word) for word in (text or "").split())
    except ValueError:
        values = ()
    if not values or not all(math.isfinite(value) for value in values):
        raise RobotFileError(f"{where}: value {text!r} is not a list of finite numbers")
    return values
