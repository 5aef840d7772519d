"""Visible shapes and colours of the links of a robot, from its URDF."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np

from kinematics import RobotModel
from kinematics.urdf import Shape, rotation_from_rpy

# Red, green, blue 0 ... 1.
Colour = tuple[float, float, float]
BODY_COLOUR: Colour = (0.47, 0.51, 0.57)
LEG_COLOUR: Colour = (0.37, 0.41, 0.48)
# Visible shape of a link, and its colour.
VisualShape = tuple[Shape, Colour]


def visual_shapes(robot: RobotModel) -> dict[str, tuple[VisualShape, ...]]:
    """Visible shapes of each link that has any, by name of the link.

    A link is drawn with its visuals if it has any and all are boxes, cylinders or spheres, otherwise with its collision
    shapes.
    """
    root = ElementTree.fromstring(robot.tree.urdf.text)
    named = {str(found.get("name")): colour for found in root.findall("material") if (colour := _colour(found))}
    by_link = {}
    for element in root.findall("link"):
        name = str(element.get("name"))
        colour = BODY_COLOUR if name == robot.config.base_frame else LEG_COLOUR
        try:
            shown = [_visual(found, named, colour) for found in element.findall("visual")]
        except (KeyError, TypeError, ValueError):
            shown = []
        if shapes := shown or [(shape, colour) for shape in robot.tree.links[name].shapes]:
            by_link[name] = tuple(shapes)
    return by_link


def _visual(element: ElementTree.Element, named: dict[str, Colour], default: Colour) -> VisualShape:
    """Shape and colour of a <visual>; raises ValueError, TypeError or KeyError if it is not a primitive shape."""
    (geometry,) = element.findall("geometry")
    (found,) = geometry
    keys = {"box": ("size",), "cylinder": ("radius", "length"), "sphere": ("radius",)}[found.tag]
    size = tuple(float(word) for name in keys for word in found.attrib[name].split())
    if len(size) != {"box": 3, "cylinder": 2, "sphere": 1}[found.tag] or min(size) <= 0.0:
        raise ValueError(f"size of a {found.tag}: {size}")
    transform = np.eye(4)
    origin = element.find("origin")
    if origin is not None:
        transform[:3, 3] = [float(word) for word in origin.get("xyz", "0 0 0").split()]
        transform[:3, :3] = rotation_from_rpy(*(float(word) for word in origin.get("rpy", "0 0 0").split()))
    material = element.find("material")
    colour = None if material is None else _colour(material) or named.get(str(material.get("name")))
    return Shape(found.tag, size, transform), colour or default


def _colour(material: ElementTree.Element) -> Colour | None:
    found = material.find("color")
    values = [] if found is None else str(found.get("rgba")).split()
    try:
        red, green, blue = (min(max(float(word), 0.0), 1.0) for word in values[:3])
    except ValueError:
        return None
    return red, green, blue
