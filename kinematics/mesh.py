"""Collision meshes: their files, and the simple shapes that replace them.

A mesh is replaced by the smallest box, cylinder or sphere, of those tried, that contains it, so that no point of the
mesh is taken for terrain. Files are read by coal (Assimp), which comes with Pinocchio.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from kinematics.arrays import Float
from kinematics.exceptions import RobotFileError

# Largest mesh file that is read [bytes].
LARGEST_MESH = 256 * 1024 * 1024

# Number of faces of the convex hull, largest first, whose orientations are tried for box and cylinder.
DIRECTIONS = 80


def find_mesh(filename: str, urdf: Path) -> Path:
    """Find the file named by a `<mesh filename>`.

    `package://NAME/rest` is searched in each ancestor folder of the URDF, if it is called NAME, and in its subfolder
    NAME; then in ROS_PACKAGE_PATH and AMENT_PREFIX_PATH. Other names are paths relative to the URDF's folder, or
    absolute, with or without `file://`.

    Raises:
        RobotFileError: the file was not found; the message lists the first paths searched.
    """
    paths = list(_paths(filename, urdf.resolve()))
    for path in paths:
        if path.is_file():
            return path
    looked = ", ".join(dict.fromkeys(str(path) for path in paths[:4]))
    raise RobotFileError(f"no mesh {filename!r} was found (looked for {looked})")


def _paths(filename: str, urdf: Path) -> Iterator[Path]:
    if filename.startswith("package://"):
        package, _, rest = filename.removeprefix("package://").partition("/")
        for folder in urdf.parents:
            if folder.name == package:
                yield folder / rest
            yield folder / package / rest
        for folder in _folders("ROS_PACKAGE_PATH"):
            yield folder / package / rest
            if folder.name == package:
                yield folder / rest
        for folder in _folders("AMENT_PREFIX_PATH"):
            yield folder / "share" / package / rest
    else:
        yield urdf.parent / filename.removeprefix("file://")


def _folders(variable: str) -> list[Path]:
    """Folders listed in an environment variable."""
    return [Path(entry) for entry in os.environ.get(variable, "").split(os.pathsep) if entry]


def read_mesh(path: Path, scale: tuple[float, ...]) -> Float:
    """Vertices (n, 3) of a mesh file (STL, OBJ, Collada or another format that Assimp reads), scaled [m].

    Raises:
        RobotFileError: the file is too large or cannot be parsed, has fewer than four points, or has a point that is
            not finite.
        OSError: the file does not exist.
    """
    import coal

    if path.stat().st_size > LARGEST_MESH:
        raise RobotFileError(f"the mesh {path} has {path.stat().st_size} bytes; at most {LARGEST_MESH} are read")
    try:
        model: Any = coal.MeshLoader().load(str(path), np.asarray(scale, dtype=np.float64))
        vertices = np.array(model.vertices(), dtype=np.float64)
    except (ValueError, RuntimeError, AttributeError) as error:
        reason = str(error).strip().splitlines()
        raise RobotFileError(f"the mesh {path} cannot be read: {reason[-1] if reason else error}") from error
    if vertices.ndim != 2 or len(vertices) < 4 or not np.all(np.isfinite(vertices)):
        raise RobotFileError(f"the mesh {path} has {len(vertices)} points; four or more, all finite, are needed")
    return vertices


@lru_cache(maxsize=256)
def mesh_shape(path: Path, scale: tuple[float, ...], stamp: int) -> tuple[str, tuple[float, ...], Float]:
    """`bounding_shape` of a mesh file with modification time `stamp` [ns]; cached, because legs share meshes."""
    return bounding_shape(read_mesh(path, scale))


def bounding_shape(vertices: Float) -> tuple[str, tuple[float, ...], Float]:
    """Smallest box, cylinder or sphere, of those tried, that contains points (n, 3).

    Returns:
        Kind of the shape ("box", "cylinder" or "sphere"), size as in `Shape`, and transform_shape_to_points (4, 4).

    Raises:
        RobotFileError: the points enclose no volume.
    """
    from scipy.spatial import ConvexHull, QhullError

    try:
        hull = ConvexHull(vertices)
    except (QhullError, ValueError) as error:
        raise RobotFileError("the points of the mesh lie in one plane; a mesh must enclose a volume") from error
    points = vertices[hull.vertices]
    transform = np.eye(4)
    transform[:3, 3] = (points.min(axis=0) + points.max(axis=0)) / 2.0
    radius = float(np.linalg.norm(points - transform[:3, 3], axis=1).max())
    best: tuple[float, str, tuple[float, ...], Float] = 4.0 / 3.0 * np.pi * radius**3, "sphere", (radius,), transform
    for rotation in _rotations(points, hull):
        local = points @ rotation
        low, high = local.min(axis=0), local.max(axis=0)
        centre, length = (low + high) / 2.0, high - low
        transform = np.eye(4)
        transform[:3, :3], transform[:3, 3] = rotation, rotation @ centre
        tried = [(float(np.prod(length)), "box", tuple(length.tolist()), transform)]
        for axis in range(3):
            across = np.delete(np.arange(3), axis)
            radius = float(np.linalg.norm((local - centre)[:, across], axis=1).max())
            turned = transform.copy()
            turned[:3, :3] = rotation[:, [*np.roll(np.arange(3), -axis - 1)]]
            tried.append((np.pi * radius**2 * float(length[axis]), "cylinder", (radius, float(length[axis])), turned))
        for candidate in tried:
            if candidate[0] < best[0] * (1.0 - 1e-9):
                best = candidate
    return best[1:]


def _rotations(points: Float, hull: Any) -> Iterator[Float]:
    """Yield candidate axes (3, 3) of box and cylinder.

    These are the axes of the file, the principal axes, and one set for each of the `DIRECTIONS` largest faces.
    """
    yield np.eye(3)
    axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2].T
    axes[:, 2] = np.cross(axes[:, 0], axes[:, 1])
    yield axes
    corners = hull.points[hull.simplices]
    edges = corners[:, 1] - corners[:, 0]
    areas = np.linalg.norm(np.cross(edges, corners[:, 2] - corners[:, 0]), axis=1)
    for face in np.argsort(-areas)[:DIRECTIONS]:
        normal = hull.equations[face, :3]
        along = edges[face] / max(float(np.linalg.norm(edges[face])), 1e-12)
        along = along - (along @ normal) * normal
        size = float(np.linalg.norm(along))
        if size > 1e-6:
            along /= size
            yield np.column_stack([along, np.cross(normal, along), normal])
