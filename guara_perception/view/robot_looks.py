"""Coloured triangle meshes of the links of a robot, from its URDF."""

from __future__ import annotations

from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np

from guara_perception.arrays import Float, Index
from kinematics import RobotModel
from kinematics.transforms import transform_points
from kinematics.urdf import Shape, rotation_from_rpy

Colour = tuple[float, float, float]
BODY_COLOUR: Colour = (0.47, 0.51, 0.57)
LEG_COLOUR: Colour = (0.37, 0.41, 0.48)
Faces = Index
# Sides of the polygon that approximates a circle.
ROUND_SIDES = 24


@dataclass(frozen=True, slots=True, eq=False)
class VisualShape:
    """Visible shape of a link.

    Attributes:
        vertices: (n, 3) in the link's frame [m].
        faces: (m, 3) indices of the vertices of each triangle, facing outwards.
        colour: red, green, blue 0 ... 1.
    """

    vertices: Float
    faces: Index
    colour: Colour


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
        shapes = shown or [(shape, colour) for shape in robot.tree.links[name].shapes]
        if shapes:
            by_link[name] = tuple(_visual_shape(*item) for item in shapes)
    return by_link


def _visual(element: ElementTree.Element, named: dict[str, Colour], default: Colour) -> tuple[Shape, Colour]:
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


def _visual_shape(shape: Shape, colour: Colour) -> VisualShape:
    vertices, faces = primitive(shape.kind, shape.size)
    transform = shape.transform_shape_to_link
    return VisualShape(transform_points(transform, vertices), faces, colour)


def primitive(kind: str, size: tuple[float, ...]) -> tuple[Float, Faces]:
    """Vertices (n, 3) [m] and outward-facing triangles (m, 3) of a primitive shape centred on the origin.

    Args:
        kind: "box", "cylinder" (axis z) or "sphere".
        size: as in `kinematics.urdf.Shape` [m].
    """
    if kind == "box":
        corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]) * size
        quads = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
        return corners, np.vstack((quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]))
    if kind == "cylinder":
        return _revolved([(0.0, -size[1] / 2), (size[0], -size[1] / 2), (size[0], size[1] / 2), (0.0, size[1] / 2)])
    angles = np.linspace(-np.pi / 2, np.pi / 2, ROUND_SIDES // 2 + 1)
    return _revolved([(float(size[0] * np.cos(a)), float(size[0] * np.sin(a))) for a in angles])


def _revolved(outline: list[tuple[float, float]]) -> tuple[Float, Faces]:
    """Vertices and triangles of the surface of revolution of an outline, given as points (radius, z), about z."""
    angles = np.arange(ROUND_SIDES) * (2 * np.pi / ROUND_SIDES)
    rings = [np.column_stack((r * np.cos(angles), r * np.sin(angles), np.full(ROUND_SIDES, z))) for r, z in outline]
    index = np.arange(ROUND_SIDES)
    following = (index + 1) % ROUND_SIDES
    faces = []
    for ring in range(len(outline) - 1):
        low, high = ring * ROUND_SIDES, (ring + 1) * ROUND_SIDES
        faces.append(np.column_stack((low + index, low + following, high + following)))
        faces.append(np.column_stack((low + index, high + following, high + index)))
    return np.vstack(rings), np.vstack(faces)
