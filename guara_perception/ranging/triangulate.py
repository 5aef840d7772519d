"""Triangulation: a stripe position is a ray, and its point is where that meets the laser plane."""

from __future__ import annotations

import numpy as np

from guara_perception.arrays import Float

# A ray that meets the laser plane at less than about 3 degrees says nothing useful about distance.
MIN_SINE_TO_SHEET = 0.05


def plane_depth(rays: Float, plane_in_camera: Float) -> tuple[Float, Float]:
    """Where rays meet a laser plane.

    Args:
        rays: (2, n) or (2, s, n) x and y in the camera frame at z = 1, NaN where there is none.
        plane_in_camera: (4,) n . X + d = 0, or (s, 4).

    Returns:
        Depth (n,) or (s, n) along the camera's z [m], NaN where the ray meets the plane at a grazing angle or behind
        the camera; and the rays' products of the same shape with the normal, by which a change of ray changes the
        depth.
    """
    x, y = rays
    nx, ny, nz, d = plane_in_camera.T[..., None]
    along_normal = nx * x
    along_normal += ny * y
    along_normal += nz
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = -d / along_normal
        is_grazing = along_normal * along_normal < MIN_SINE_TO_SHEET**2 * (x * x + y * y + 1)
        unusable = is_grazing | (depth <= 0)
    if unusable.any():
        depth[unusable] = np.nan
    return depth, along_normal


def laser_origin(planes: Float, near: Float) -> Float:
    """The point of the mirror axis nearest to `near`: all laser planes pass (almost) through that line.

    Args:
        planes: (s, 4) planes of all stripes in one frame.
        near: (3,) a point in the same frame, for instance the camera.

    Returns:
        (3,) point in that frame. The axis is the line that fits all planes in the least-squares sense.
    """
    normals, offsets = planes[:, :3], planes[:, 3]
    axis = np.linalg.svd(normals)[2][-1]
    rows = np.vstack((normals, axis))
    return np.linalg.lstsq(rows, np.append(-offsets, axis @ near), rcond=None)[0]
