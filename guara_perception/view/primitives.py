"""Boxes, cylinders and spheres as triangles."""

from __future__ import annotations

import numpy as np

from guara_perception.arrays import Float, Index

Faces = Index

# Sides of the polygon that stands for a circle.
ROUND_SIDES = 24


def primitive(kind: str, size: tuple[float, ...]) -> tuple[Float, Faces]:
    """Vertices (n, 3) [m] and triangles (m, 3) that face outwards, about the origin.

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
    """Vertices and triangles of the solid that an outline of points (radius, z) makes when it is rotated about z."""
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
