"""Which links of a robot touch one another in a posture, by coal on the collision shapes."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import combinations
from typing import Any

import numpy as np

from guara_perception.arrays import Float
from kinematics.state import RobotState
from kinematics.urdf import Shape, Urdf

# Links that are joined by this many moving joints touch by construction: hip, thigh and body of most robots.
NEIGHBOUR_JOINTS = 2


def neighbours(urdf: Urdf) -> list[tuple[str, str]]:
    """Pairs of links with shapes that two moving joints or fewer lie between."""
    with_shapes = [link.name for link in urdf.links if link.shapes]
    return [pair for pair in combinations(with_shapes, 2) if _joints_between(urdf, *pair) <= NEIGHBOUR_JOINTS]


def _joints_between(urdf: Urdf, first: str, second: str) -> int:
    one, other = ({j.name for j in urdf.path_to(link) if j.kind != "fixed"} for link in (first, second))
    return len(one ^ other)


def touching(state: RobotState, allowed: Iterable[tuple[str, str]]) -> list[tuple[str, str]]:
    """Pairs of links whose shapes touch, but for those that may; links joined by one moving joint always do.

    Args:
        state: of the robot.
        allowed: pairs of link names, in either order.
    """
    import coal

    passed = {frozenset(pair) for pair in allowed}
    placed: list[tuple[str, Any, Any]] = []
    for name, link in state.tree.links.items():
        for shape in link.shapes:
            transform: Float = state.transform_to_base(name) @ shape.transform_shape_to_link
            placed.append((name, _geometry(shape), coal.Transform3s(transform[:3, :3], transform[:3, 3])))
    found: dict[tuple[str, str], None] = {}
    request = coal.CollisionRequest()
    for (first, one, at), (second, other, there) in combinations(placed, 2):
        if first == second or frozenset((first, second)) in passed or (first, second) in found:
            continue
        if _joints_between(state.tree.urdf, first, second) <= 1:
            passed.add(frozenset((first, second)))
            continue
        if coal.collide(one, at, other, there, request, coal.CollisionResult()):
            found[first, second] = None
    return list(found)


def _geometry(shape: Shape) -> Any:
    import coal

    if shape.kind == "box":
        return coal.Box(np.asarray(shape.size, dtype=np.float64))
    if shape.kind == "cylinder":
        return coal.Cylinder(*shape.size)
    return coal.Sphere(shape.size[0])
