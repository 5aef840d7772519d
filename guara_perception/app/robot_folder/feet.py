"""Where the foot of a leg is: the shape at its end, and the point at which it touches the ground."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from guara_perception.app.robot_folder.find_legs import FoundLeg
from guara_perception.arrays import Float
from kinematics.model_checks import extent_along
from kinematics.urdf import Joint, Link, Shape, Urdf

# Longer than wide by more than this, a shape is a bone with the foot at its end, else it is the foot.
BONE_RATIO = 1.5


@dataclass(frozen=True, slots=True, eq=False)
class Foot:
    """The end of a leg, in the frame of the last moving link.

    Attributes:
        link: the last moving link.
        tip: (3,) centre of the foot, or of the round end of the bone [m].
        shapes: what moves rigidly with it, each with transform_shape_to_link (4, 4).
        is_round: whether the foot is a ball or the end of a bone: it touches in a point.
        size: (3,) extents of the foot along its own axes; a ball's diameter, a bone's width [m].
    """

    link: str
    tip: Float
    shapes: tuple[tuple[Shape, Float], ...]
    is_round: bool
    size: Float

    def lowest(self, rotation: Float) -> float:
        """How far the lowest point of all shapes is below the tip, with the link turned by a rotation (3, 3) [m]."""
        down = np.array([0.0, 0.0, -1.0])
        depths = [
            extent_along(shape, rotation @ m[:3, :3], down) + float(down @ (rotation @ (m[:3, 3] - self.tip)))
            for shape, m in self.shapes
        ]
        return max(depths, default=0.0)


def find_foot(urdf: Urdf, leg: FoundLeg) -> Foot:
    """The foot of a leg: of the shapes on its last moving link the one that ends farthest from the last joint."""
    link = next(joint.child for joint in urdf.joints if joint.name == leg.joints[-1])
    shapes = tuple(rigid_shapes(urdf, link))
    if not shapes:
        return Foot(link, _farthest_frame(urdf, link), (), True, np.zeros(3))

    def reach(item: tuple[Shape, Float]) -> float:
        shape, m = item
        distance = float(np.linalg.norm(m[:3, 3]))
        direction = m[:3, 3] / distance if distance > 1e-9 else np.array([0.0, 0.0, -1.0])
        return distance + extent_along(shape, m[:3, :3], direction)

    shape, m = max(shapes, key=reach)
    full = _full_size(shape)
    long_axis = int(np.argmax(full))
    width = float(np.median(full))
    if full[long_axis] <= BONE_RATIO * width:
        return Foot(link, m[:3, 3].copy(), shapes, shape.kind == "sphere" or len(leg.joints) < 4, full)
    along = m[:3, long_axis] * np.sign(m[:3, long_axis] @ m[:3, 3] or 1.0)
    if len(leg.joints) >= 4 and abs(along[2]) < 0.5:
        return Foot(link, m[:3, 3].copy(), shapes, False, full)
    tip = m[:3, 3] + along * (full[long_axis] - width) / 2.0
    return Foot(link, tip, shapes, True, np.full(3, width))


def rigid_shapes(urdf: Urdf, link: str) -> list[tuple[Shape, Float]]:
    """The shapes of a link and of all links fixed below it, each with transform_shape_to_link (4, 4)."""
    links: dict[str, Link] = {item.name: item for item in urdf.links}
    fixed: dict[str, list[Joint]] = {}
    for joint in urdf.joints:
        if joint.kind == "fixed":
            fixed.setdefault(joint.parent, []).append(joint)
    found: list[tuple[Shape, Float]] = []
    open_links = [(link, np.eye(4))]
    while open_links:
        name, transform = open_links.pop()
        found += [(shape, transform @ shape.transform_shape_to_link) for shape in links[name].shapes]
        open_links += [(joint.child, transform @ joint.transform_child_to_parent) for joint in fixed.get(name, [])]
    return found


def _full_size(shape: Shape) -> Float:
    if shape.kind == "box":
        return np.asarray(shape.size, dtype=np.float64)
    if shape.kind == "cylinder":
        return np.array([2.0 * shape.size[0], 2.0 * shape.size[0], shape.size[1]])
    return np.full(3, 2.0 * shape.size[0])


def _farthest_frame(urdf: Urdf, link: str) -> Float:
    """Origin of the frame farthest down a chain without shapes."""
    best, open_links = np.zeros(3), [(link, np.eye(4))]
    while open_links:
        name, transform = open_links.pop()
        if np.linalg.norm(transform[:3, 3]) > np.linalg.norm(best):
            best = transform[:3, 3].copy()
        for joint in urdf.joints:
            if joint.parent == name and joint.kind == "fixed":
                open_links.append((joint.child, transform @ joint.transform_child_to_parent))
    return best
