"""Pairs of neighbouring links of a robot, and pairs in contact in a posture, found with the library coal."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import combinations
from typing import Any

import numpy as np

from guara_perception.arrays import Float
from kinematics.tree import RobotState
from kinematics.urdf import Shape, Urdf

# Links with at most this number of moving joints between them are expected to overlap at the joint in any posture.
JOINED_JOINTS = 1
# Links with at most this number of moving joints between them overlap in most robots (body, hip and thigh), so motion
# planners should skip such pairs (`neighbours`). `touching` checks a single posture, in which the contact of links with
# two joints between them may be a real collision, and reports it.
NEIGHBOUR_JOINTS = 2


def neighbours(urdf: Urdf) -> list[tuple[str, str]]:
    """Pairs of links with collision shapes and at most NEIGHBOUR_JOINTS moving joints between them."""
    with_shapes = [link.name for link in urdf.links if link.shapes]
    return [pair for pair in combinations(with_shapes, 2) if _joints_between(urdf, *pair) <= NEIGHBOUR_JOINTS]


def _joints_between(urdf: Urdf, first: str, second: str) -> int:
    one, other = ({j.name for j in urdf.path_to(link) if j.kind != "fixed"} for link in (first, second))
    return len(one ^ other)


def touching(state: RobotState, allowed: Iterable[tuple[str, str]]) -> list[tuple[str, str]]:
    """Pairs of links in contact, except allowed pairs and links connected by at most JOINED_JOINTS moving joints.

    Args:
        state: joint positions of a robot.
        allowed: pairs of link names that may touch, in either order.
    """
    import coal

    skipped = {frozenset(pair) for pair in allowed}
    shapes: list[tuple[str, Any, Any]] = []
    for name, link in state.tree.links.items():
        for shape in link.shapes:
            transform: Float = state.transform_to_base(name) @ shape.transform_shape_to_link
            shapes.append((name, _geometry(shape), coal.Transform3s(transform[:3, :3], transform[:3, 3])))
    found: list[tuple[str, str]] = []
    request = coal.CollisionRequest()
    for (first, first_shape, first_pose), (second, second_shape, second_pose) in combinations(shapes, 2):
        if first == second or frozenset((first, second)) in skipped or (first, second) in found:
            continue
        if _joints_between(state.tree.urdf, first, second) <= JOINED_JOINTS:
            skipped.add(frozenset((first, second)))
            continue
        if coal.collide(first_shape, first_pose, second_shape, second_pose, request, coal.CollisionResult()):
            found.append((first, second))
    return found


def _geometry(shape: Shape) -> Any:
    import coal

    if shape.kind == "box":
        return coal.Box(np.asarray(shape.size, dtype=np.float64))
    if shape.kind == "cylinder":
        return coal.Cylinder(*shape.size)
    return coal.Sphere(shape.size[0])
