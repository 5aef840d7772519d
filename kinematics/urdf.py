"""Reads a URDF file into plain values, refusing what other readers pass over in silence.

Only what a robot folder may hold is accepted: links with inertia and primitive shapes, and fixed, revolute
and prismatic joints. A misspelt element or attribute is an error, because every URDF reader ignores it and
takes the default.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from kinematics.arrays import Float
from kinematics.exceptions import RobotFileError

CHILDREN = {
    "robot": {"link", "joint", "material", "mujoco", "gazebo", "transmission"},
    "link": {"inertial", "visual", "collision"},
    "inertial": {"origin", "mass", "inertia"},
    "visual": {"origin", "geometry", "material"},
    "collision": {"origin", "geometry"},
    "geometry": {"box", "cylinder", "sphere"},
    "joint": {"origin", "parent", "child", "axis", "limit", "dynamics", "safety_controller"},
}
ATTRIBUTES = {
    "link": {"name"},
    "joint": {"name", "type"},
    "origin": {"xyz", "rpy"},
    "axis": {"xyz"},
    "mass": {"value"},
    "inertia": {"ixx", "ixy", "ixz", "iyy", "iyz", "izz"},
    "limit": {"lower", "upper", "effort", "velocity"},
    "parent": {"link"},
    "child": {"link"},
    "box": {"size"},
    "cylinder": {"radius", "length"},
    "sphere": {"radius"},
}
UNREAD = {"material", "mujoco", "gazebo", "transmission", "dynamics", "safety_controller"}


@dataclass(frozen=True, slots=True)
class Shape:
    """One collision primitive of a link.

    Attributes:
        kind: "box", "cylinder" (axis z) or "sphere".
        size: box (x, y, z), cylinder (radius, length), sphere (radius,) [m].
        transform_shape_to_link: (4, 4).
    """

    kind: str
    size: tuple[float, ...]
    transform_shape_to_link: Float


@dataclass(frozen=True, slots=True)
class Link:
    """One link: mass [kg], centre of mass (3,) [m], inertia about it (3, 3) [kg m^2], collision shapes."""

    name: str
    mass: float | None
    centre_of_mass: Float
    inertia: Float
    shapes: tuple[Shape, ...]


@dataclass(frozen=True, slots=True)
class Joint:
    """One joint; `axis` (3,) in the joint's frame, limits [rad] or [m], zero for fixed joints."""

    name: str
    kind: str
    parent: str
    child: str
    transform_child_to_parent: Float
    axis: Float
    lower: float
    upper: float


@dataclass(frozen=True, slots=True)
class Urdf:
    """A URDF file: its links and joints in the order of the file, and its text."""

    path: Path
    name: str
    links: tuple[Link, ...]
    joints: tuple[Joint, ...]
    text: str


def read_urdf(path: Path) -> Urdf:
    """Read a URDF file.

    Raises:
        RobotFileError: the file is missing, no XML, or an element or value is wrong; the message names link
            or joint.
    """
    try:
        text = path.read_text(encoding="utf-8")
        root = ElementTree.fromstring(text.encode("utf-8"))
    except OSError as error:
        raise RobotFileError(f"{path}: cannot be read: {error.strerror}") from error
    except (ElementTree.ParseError, UnicodeDecodeError) as error:
        raise RobotFileError(f"{path}: is not valid XML: {error}") from error
    try:
        if root.tag != "robot":
            raise RobotFileError(f"the outermost element is <{root.tag}>, not <robot>")
        _check_words(root, "robot")
        links = tuple(_link(element) for element in root.findall("link"))
        joints = tuple(_joint(element) for element in root.findall("joint"))
    except RobotFileError as error:
        raise RobotFileError(f"{path}: {error}") from None
    return Urdf(path, root.get("name", ""), links, joints, text)


def _check_words(element: Element, where: str) -> None:
    """Refuse elements and attributes that a URDF does not have at this place, all the way down."""
    allowed = ATTRIBUTES.get(element.tag)
    for attribute in element.attrib:
        if allowed is not None and attribute not in allowed:
            raise RobotFileError(
                f"{where}: attribute {attribute!r} of <{element.tag}> is unknown; allowed: {', '.join(sorted(allowed))}"
            )
    for child in element:
        if child.tag not in CHILDREN.get(element.tag, set()):
            names = ", ".join(sorted(CHILDREN.get(element.tag, set()))) or "none"
            raise RobotFileError(f"{where}: element <{child.tag}> is not allowed in <{element.tag}>; allowed: {names}")
        if child.tag not in UNREAD:
            named = child.tag in ("link", "joint")
            _check_words(child, f"{child.tag} {child.get('name')!r}" if named else where)


def _only(element: Element, tag: str, where: str) -> Element | None:
    found = element.findall(tag)
    if len(found) > 1:
        raise RobotFileError(f"{where}: <{tag}> is given {len(found)} times; once is allowed")
    return found[0] if found else None


def _needed(element: Element, tag: str, where: str) -> Element:
    found = _only(element, tag, where)
    if found is None:
        raise RobotFileError(f"{where}: <{tag}> is missing")
    return found


def _attribute(element: Element, name: str, where: str) -> str:
    value = element.get(name)
    if value is None:
        raise RobotFileError(f"{where}: <{element.tag}> has no attribute {name!r}")
    return value


def _numbers(text: str, count: int, what: str, where: str) -> tuple[float, ...]:
    try:
        numbers = tuple(float(word) for word in text.split())
    except ValueError:
        numbers = ()
    if len(numbers) != count or not all(math.isfinite(number) for number in numbers):
        raise RobotFileError(
            f"{where}: {what} is {text!r}; needed: {count} finite number{'s' * (count > 1)} parted by spaces"
        )
    return numbers


def _number(element: Element, name: str, where: str) -> float:
    return _numbers(_attribute(element, name, where), 1, f"{name!r} of <{element.tag}>", where)[0]


def _origin(element: Element, where: str) -> Float:
    origin = _only(element, "origin", where)
    transform = np.eye(4)
    if origin is not None:
        transform[:3, 3] = _numbers(origin.get("xyz", "0 0 0"), 3, "xyz of <origin>", where)
        transform[:3, :3] = rotation_from_rpy(*_numbers(origin.get("rpy", "0 0 0"), 3, "rpy of <origin>", where))
    transform.setflags(write=False)
    return transform


def rotation_from_rpy(roll: float, pitch: float, yaw: float) -> Float:
    """Rotation (3, 3) by roll, pitch, yaw [rad] about the fixed axes x, y, z, as URDF defines rpy."""
    cr, sr, cp, sp, cy, sy = (f(a) for a in (roll, pitch, yaw) for f in (math.cos, math.sin))
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def _link(element: Element) -> Link:
    name = element.get("name")
    if not name:
        raise RobotFileError("a <link> has no name")
    where = f"link {name!r}"
    inertial = _only(element, "inertial", where)
    mass, centre, inertia = None, np.zeros(3), np.zeros((3, 3))
    if inertial is not None:
        mass = _number(_needed(inertial, "mass", where), "value", where)
        transform = _origin(inertial, where)
        moments = _needed(inertial, "inertia", where)
        xx, xy, xz, yy, yz, zz = (_number(moments, key, where) for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"))
        tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        centre, inertia = transform[:3, 3].copy(), transform[:3, :3] @ tensor @ transform[:3, :3].T
    shapes = tuple(_shape(collision, where) for collision in element.findall("collision"))
    return Link(name, mass, centre, inertia, shapes)


def _shape(collision: Element, where: str) -> Shape:
    geometry = _needed(collision, "geometry", where)
    if len(geometry) != 1:
        raise RobotFileError(f"{where}: <geometry> of <collision> holds {len(geometry)} shapes; exactly one is needed")
    shape = geometry[0]
    if shape.tag == "box":
        size = _numbers(_attribute(shape, "size", where), 3, "size of <box>", where)
    elif shape.tag == "cylinder":
        size = (_number(shape, "radius", where), _number(shape, "length", where))
    else:
        size = (_number(shape, "radius", where),)
    if min(size) <= 0.0:
        raise RobotFileError(f"{where}: size of <{shape.tag}> is {size}; every length must be positive")
    return Shape(shape.tag, size, _origin(collision, where))


def _joint(element: Element) -> Joint:
    name = element.get("name")
    if not name:
        raise RobotFileError("a <joint> has no name")
    where = f"joint {name!r}"
    kind = _attribute(element, "type", where)
    if kind not in ("fixed", "revolute", "prismatic"):
        raise RobotFileError(f"{where}: type {kind!r} is not supported; use fixed, revolute or prismatic")
    parent = _attribute(_needed(element, "parent", where), "link", where)
    child = _attribute(_needed(element, "child", where), "link", where)
    axis, lower, upper = np.array([1.0, 0.0, 0.0]), 0.0, 0.0
    if kind != "fixed":
        axis_element = _only(element, "axis", where)
        if axis_element is not None:
            axis = np.array(_numbers(_attribute(axis_element, "xyz", where), 3, "xyz of <axis>", where))
        limit = _needed(element, "limit", where)
        lower, upper = _number(limit, "lower", where), _number(limit, "upper", where)
        _number(limit, "effort", where)
        _number(limit, "velocity", where)
    return Joint(name, kind, parent, child, _origin(element, where), axis, lower, upper)
