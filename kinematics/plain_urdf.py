"""Writes a URDF that holds only what is used: links with mass and primitive shapes, joints with limits.

A new robot folder gets this text, and a grid carries it in the description of its robot.
"""

from __future__ import annotations

from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from kinematics.arrays import Float
from kinematics.urdf import Joint, Link, Shape, Urdf, rpy_from_rotation


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
