"""A robot in one line of text: what a grid carries, so that whoever receives it can ask about its legs.

The text holds robot.toml, SRDF and what is used of the URDF, compressed. It may come from anywhere: its size is
limited, its files are read by the same checks as a folder's, and no other file of this machine is opened for it.
"""

from __future__ import annotations

import base64
import binascii
import json
import re
import tempfile
import zlib
from functools import lru_cache
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from kinematics.arrays import Float
from kinematics.exceptions import RobotFileError
from kinematics.load import load_robot
from kinematics.model import RobotModel
from kinematics.urdf import Joint, Link, Shape, Urdf, rpy_from_rotation

# [byte] The description of a stock robot has some 5 kB, and 100 kB unpacked.
LARGEST_TEXT = 1_000_000
LARGEST_UNPACKED = 8_000_000
SOURCE = "robot description"


@lru_cache(maxsize=8)
def describe_robot(robot: RobotModel) -> str:
    """The description of a robot; `robot_from_description` makes the same robot of it."""
    files = {"name": robot.name, "toml": robot.toml_text, "urdf": plain_urdf(robot.tree.urdf), "srdf": robot.srdf_text}
    return base64.b64encode(zlib.compress(json.dumps(files).encode("utf-8"), 9)).decode("ascii")


def robot_from_description(text: str) -> RobotModel:
    """The robot of a description.

    Raises:
        RobotFileError: the text is damaged or too long, or the robot in it is not sound.
    """
    if len(text) > LARGEST_TEXT:
        raise RobotFileError(f"{SOURCE}: {len(text)} characters; at most {LARGEST_TEXT} are read")
    try:
        unpacker = zlib.decompressobj()
        content = unpacker.decompress(base64.b64decode(text, validate=True), LARGEST_UNPACKED)
        files = json.loads(content)
        name, toml, urdf, srdf = (str(files[key]) for key in ("name", "toml", "urdf", "srdf"))
    except (binascii.Error, zlib.error, ValueError, KeyError, TypeError, RecursionError) as error:
        raise RobotFileError(f"{SOURCE}: is damaged, or longer than {LARGEST_UNPACKED} bytes: {error}") from error
    if re.fullmatch(r"[A-Za-z0-9_-]+", name) is None or "<mesh" in urdf:
        raise RobotFileError(
            f"{SOURCE}: the robot's name is {name[:40]!r}, or its URDF names mesh files; neither is read"
        )
    with tempfile.TemporaryDirectory(prefix="robot-") as made:
        folder = Path(made)
        for file, content_of in (("robot.toml", toml), (f"urdf/{name}.urdf", urdf), (f"srdf/{name}.srdf", srdf)):
            (folder / file).parent.mkdir(exist_ok=True)
            (folder / file).write_text(content_of, encoding="utf-8")
        return load_robot(folder)


def plain_urdf(urdf: Urdf, *, with_shapes: bool = True) -> str:
    """The text of a URDF that holds what was read of another one, in the same order.

    Args:
        urdf: what was read.
        with_shapes: whether to write the collision shapes.
    """
    root = Element("robot", name=urdf.name)
    for link in urdf.links:
        _add_link(root, link, with_shapes=with_shapes)
    for joint in urdf.joints:
        _add_joint(root, joint)
    ElementTree.indent(root)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def _add_link(root: Element, link: Link, *, with_shapes: bool) -> None:
    element = SubElement(root, "link", name=link.name)
    if link.mass:
        inertial = SubElement(element, "inertial")
        SubElement(inertial, "origin", xyz=_numbers(link.centre_of_mass), rpy="0 0 0")
        SubElement(inertial, "mass", value=repr(float(link.mass)))
        (xx, xy, xz), (_, yy, yz), (_, _, zz) = ([repr(float(v)) for v in row] for row in link.inertia)
        SubElement(inertial, "inertia", ixx=xx, ixy=xy, ixz=xz, iyy=yy, iyz=yz, izz=zz)
    for shape in link.shapes if with_shapes else ():
        collision = SubElement(element, "collision")
        _add_origin(collision, shape.transform_shape_to_link)
        _add_shape(SubElement(collision, "geometry"), shape)


def _add_shape(geometry: Element, shape: Shape) -> None:
    if shape.kind == "box":
        SubElement(geometry, "box", size=_numbers(shape.size))
    elif shape.kind == "cylinder":
        SubElement(geometry, "cylinder", radius=repr(shape.size[0]), length=repr(shape.size[1]))
    else:
        SubElement(geometry, "sphere", radius=repr(shape.size[0]))


def _add_joint(root: Element, joint: Joint) -> None:
    element = SubElement(root, "joint", name=joint.name, type=joint.kind)
    _add_origin(element, joint.transform_child_to_parent)
    SubElement(element, "parent", link=joint.parent)
    SubElement(element, "child", link=joint.child)
    if joint.kind != "fixed":
        SubElement(element, "axis", xyz=_numbers(joint.axis))
        # Readers of URDF demand effort and velocity of a <limit>; nobody uses them here.
        SubElement(element, "limit", lower=repr(joint.lower), upper=repr(joint.upper), effort="0", velocity="0")


def _add_origin(element: Element, transform: Float) -> None:
    SubElement(element, "origin", xyz=_numbers(transform[:3, 3]), rpy=_numbers(rpy_from_rotation(transform[:3, :3])))


def _numbers(values: object) -> str:
    return " ".join(repr(float(value)) for value in values)  # type: ignore[attr-defined]
