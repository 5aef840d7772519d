"""Reader of URDF files that checks every element it uses and skips all others.

All errors are reported at once, each with its line. Visuals and vendor-specific elements are not used. Masses are
needed only for the centre of mass, so a link without <inertial> is assumed to be massless.

Other URDF readers skip unknown names and use default values, so a misspelt <origin> misplaces a link without a warning.
Here an unknown element or attribute that looks misspelt is an error; others are noted, except the elements in `COMMON`.
The attributes of <robot>, <inertial>, <collision> and <geometry> are not checked.
"""

from __future__ import annotations

import math
from difflib import get_close_matches
from itertools import chain
from pathlib import Path

import numpy as np

from kinematics.arrays import Float
from kinematics.exceptions import RobotFileError
from kinematics.findings import Findings
from kinematics.mesh import find_mesh, mesh_shape
from kinematics.untrusted import Element, finite_numbers, parse_xml, read_xml
from kinematics.urdf import SIZES, Joint, Link, Shape, Urdf, rotation_from_rpy

Numbers = tuple[float, ...]
# Tolerance of the triangle inequality, relative to the largest principal moment of inertia. It covers the rounding of
# values written with seven significant digits.
TRIANGLE_TOLERANCE = 1e-6
READ = {
    "robot": ("link", "joint"),
    "link": ("inertial", "collision"),
    "inertial": ("origin", "mass", "inertia"),
    "collision": ("origin", "geometry"),
    "geometry": (*SIZES, "mesh"),
    "joint": ("origin", "parent", "child", "axis", "limit"),
}
ATTRIBUTES = {
    "link": ("name",),
    "joint": ("name", "type"),
    "origin": ("xyz", "rpy"),
    "axis": ("xyz",),
    "mass": ("value",),
    "inertia": ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"),
    "limit": ("lower", "upper", "effort", "velocity"),
    "parent": ("link",),
    "child": ("link",),
    "mesh": ("filename", "scale"),
    **{shape: tuple(sizes) for shape, sizes in SIZES.items()},
}
# Elements of the URDF specification and of simulators that are skipped without a note. Other unused ones are noted.
COMMON = {
    "robot": {"material", "mujoco", "gazebo", "transmission", "drake", "sensor"},
    "link": {"visual"},
    "joint": {"dynamics", "safety_controller", "calibration"},
    "collision": {"material"},
    "visual": {"origin", "geometry", "material"},
}
# Lowest similarity (`difflib`) at which an unknown name counts as a misspelt known one.
LIKE_AN_ELEMENT, LIKE_AN_ATTRIBUTE = 0.75, 0.6


def read_urdf(path: Path, text: str | None = None) -> Urdf:
    """Read a URDF file.

    Args:
        path: the file.
        text: text of the file; None = read it.

    Raises:
        RobotFileError: the file cannot be read or is not XML, its root is not <robot>, or elements or values that are
            used are missing, wrong or look misspelt; the message lists all of these with their lines.
    """
    root, text = read_xml(path) if text is None else (parse_xml(text, path), text)
    if root.tag != "robot":
        raise RobotFileError(f"{path}: the outermost element is <{root.tag}>, not <robot>")
    if any(child.tag.startswith("xacro:") for child in root.iter()):
        raise RobotFileError(f"{path}: has xacro macros: expand it first (xacro {path.name} > robot.urdf)")
    reader = _Reader(path)
    check_words(root, "robot", reader.findings)
    links = tuple(reader.link(element) for element in root.findall("link"))  # type: ignore[arg-type]
    joints = tuple(reader.joint(element) for element in root.findall("joint"))  # type: ignore[arg-type]
    reader.findings.refuse()
    return Urdf(path, root.get("name", ""), links, joints, text, reader.findings.notes)


class _Reader:
    """Reader of the elements of one file; a wrong value is recorded as a finding, and reading continues."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.findings = Findings(path)

    def _only(self, element: Element, tag: str, where: str, *, needed: bool = False) -> Element | None:
        found = element.findall(tag)
        if len(found) > 1:
            self.findings.wrong(f"{where}: <{tag}> occurs {len(found)} times; at most one is allowed", element.line)
        elif not found and needed:
            self.findings.wrong(f"{where}: <{tag}> is missing", element.line)
        return found[0] if found else None  # type: ignore[return-value]

    def _text(self, element: Element | None, name: str, where: str) -> str:
        if element is None:
            return ""
        value = element.get(name)
        if value is None:
            self.findings.wrong(f"{where}: <{element.tag}> has no attribute {name!r}", element.line)
        return value or ""

    def _attribute(self, element: Element | None, name: str, default: Numbers, where: str) -> Numbers:
        """Numbers of a required attribute, as many as in `default`, which replaces a missing or wrong value."""
        text = self._text(element, name, where)
        if element is None or element.get(name) is None:
            return default
        numbers, count = finite_numbers(text), len(default)
        if len(numbers) == count:
            return numbers
        self.findings.wrong(
            f"{where}: {name} of <{element.tag}> is {text!r}; needed: {count} finite number{'s' * (count > 1)} "
            "separated by spaces",
            element.line,
        )
        return default

    def _origin(self, element: Element, where: str) -> Float:
        origin = self._only(element, "origin", where)
        transform = np.eye(4)
        if origin is not None and origin.get("xyz") is not None:
            transform[:3, 3] = self._attribute(origin, "xyz", (0.0, 0.0, 0.0), where)
        if origin is not None and origin.get("rpy") is not None:
            transform[:3, :3] = rotation_from_rpy(*self._attribute(origin, "rpy", (0.0, 0.0, 0.0), where))
        transform.setflags(write=False)
        return transform

    def _named(self, element: Element) -> tuple[str, str]:
        """Check the names used in a link or joint; return its own name and its designation in messages."""
        name = element.get("name", "")
        if not name:
            self.findings.wrong(f"a <{element.tag}> has no name", element.line)
        where = f"{element.tag} {name!r}"
        check_words(element, where, self.findings)
        return name, where

    def link(self, element: Element) -> Link:
        """Read a <link>."""
        name, where = self._named(element)
        inertial = self._only(element, "inertial", where)
        mass, centre, inertia = None, np.zeros(3), np.zeros((3, 3))
        if inertial is not None:
            (mass,) = self._attribute(self._only(inertial, "mass", where, needed=True), "value", (0.0,), where)
            if mass < 0.0:
                self.findings.wrong(f"{where}: mass is {mass:g} kg; it must not be negative", inertial.line)
            transform = self._origin(inertial, where)
            centre, inertia = transform[:3, 3].copy(), self._inertia(inertial, transform, mass)
        shapes = tuple(shape for found in element.findall("collision") if (shape := self._shape(found, where)))  # type: ignore[arg-type]
        return Link(name, mass, centre, inertia, shapes, element.line)

    def _inertia(self, inertial: Element, transform: Float, mass: float) -> Float:
        """Inertia (3, 3) about the centre of mass, along the link's axes; zero if missing, malformed or impossible.

        An inertia that is malformed or impossible is noted if the link has a mass, unless the inertia is zero.
        """
        inertia = inertial.find("inertia")
        if inertia is None:
            return np.zeros((3, 3))
        try:
            xx, xy, xz, yy, yz, zz = (float(inertia.get(k, "")) for k in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"))
            tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
            principal = np.linalg.eigvalsh(tensor)
        except (ValueError, np.linalg.LinAlgError):
            principal = np.full(3, -1.0)
        is_possible = principal[0] > 0.0 and principal[0] + principal[1] >= principal[2] * (1.0 - TRIANGLE_TOLERANCE)
        if not is_possible:
            if mass > 0.0 and np.any(principal != 0.0):
                self.findings.unused("<inertia> that is malformed or physically impossible")
            return np.zeros((3, 3))
        return np.asarray(transform[:3, :3] @ tensor @ transform[:3, :3].T)

    def _shape(self, collision: Element, where: str) -> Shape | None:
        geometry = self._only(collision, "geometry", where, needed=True)
        if geometry is None:
            return None
        known = [child for child in geometry if child.tag in READ["geometry"]]
        if len(known) != 1:
            held = f"<geometry> of <collision> holds {len(known)} shapes"
            self.findings.wrong(f"{where}: {held}; exactly one is needed", geometry.line)
            return None
        shape, transform = known[0], self._origin(collision, where)
        assert isinstance(shape, Element)
        if shape.tag == "mesh":
            return self._mesh(shape, transform, where)
        sizes = [self._attribute(shape, name, (1.0,) * count, where) for name, count in SIZES[shape.tag].items()]
        size = tuple(chain(*sizes))
        if min(size) <= 0.0:
            self.findings.wrong(f"{where}: size of <{shape.tag}> is {size}; every length must be positive", shape.line)
            return None
        if shape.tag == "capsule":
            # The cylinder extended by both round ends encloses the capsule.
            return Shape("cylinder", (size[0], size[1] + 2.0 * size[0]), transform)
        return Shape(shape.tag, size, transform)

    def _mesh(self, mesh: Element, transform: Float, where: str) -> Shape | None:
        name = self._text(mesh, "filename", where)
        scale: Numbers = (1.0, 1.0, 1.0)
        if mesh.get("scale") is not None:
            scale = self._attribute(mesh, "scale", scale, where)
        try:
            path = find_mesh(name, self.path)
            kind, size, placed = mesh_shape(path, scale, path.stat().st_mtime_ns)
        except RobotFileError as error:
            self.findings.unused(f"{where}: a mesh is not used, so the self-filter ignores it: {error}")
            return None
        return Shape(kind, size, np.asarray(transform @ placed))

    def joint(self, element: Element) -> Joint:
        """Read a <joint>."""
        name, where = self._named(element)
        kind = self._text(element, "type", where)
        if kind not in ("fixed", "revolute", "prismatic", "continuous", ""):
            self.findings.wrong(
                f"{where}: type {kind!r} is not supported; use fixed, revolute, continuous or prismatic", element.line
            )
        parent = self._text(self._only(element, "parent", where, needed=True), "link", where)
        child = self._text(self._only(element, "child", where, needed=True), "link", where)
        axis, lower, upper = np.array([1.0, 0.0, 0.0]), 0.0, 0.0
        if kind != "fixed":
            lower, upper = -math.pi, math.pi
            given = self._only(element, "axis", where)
            if given is not None:
                axis = np.array(self._attribute(given, "xyz", (1.0, 0.0, 0.0), where))
            if kind != "continuous":
                limit = self._only(element, "limit", where, needed=True)
                (lower,) = self._attribute(limit, "lower", (lower,), where)
                (upper,) = self._attribute(limit, "upper", (upper,), where)
        kind = kind if kind in ("fixed", "prismatic") else "revolute"
        return Joint(name, kind, parent, child, self._origin(element, where), axis, lower, upper, element.line)


def check_words(element: Element, where: str, findings: Findings) -> None:
    """Check the names of the attributes and child elements of an element, and recursively of the children in `READ`.

    Children <link> and <joint> are not checked.

    Args:
        element: element to check.
        where: link, joint or robot that the element belongs to, for messages.
        findings: receives names that look misspelt as errors, and other unknown names as notes.
    """
    known = ATTRIBUTES.get(element.tag)
    for attribute in element.attrib:
        if known is not None and attribute not in known:
            like = get_close_matches(attribute, known, 1, LIKE_AN_ATTRIBUTE)
            if like and like[0] not in element.attrib:
                findings.wrong(
                    f"{where}: attribute {attribute!r} of <{element.tag}> is unknown; did you mean {like[0]!r}?",
                    element.line,
                )
            else:
                findings.unused(f"attribute {attribute!r} of <{element.tag}>")
    read = READ.get(element.tag, ())
    for child in element:
        assert isinstance(child, Element)
        if child.tag in ("link", "joint"):
            continue
        if child.tag in read:
            check_words(child, where, findings)
        elif child.tag not in COMMON.get(element.tag, ()):
            like = get_close_matches(child.tag, read, 1, LIKE_AN_ELEMENT)
            if like:
                findings.wrong(
                    f"{where}: element <{child.tag}> is not allowed in <{element.tag}>; did you mean <{like[0]}>?",
                    child.line,
                )
            else:
                findings.unused(f"element <{child.tag}> in <{element.tag}>")
