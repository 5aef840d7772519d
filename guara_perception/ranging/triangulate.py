"""Triangulation: a stripe position in a column becomes a point where its ray meets the laser sheet."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from guara_perception.calibration.camera import CameraModel

Float = npt.NDArray[np.float64]

# A ray that meets the sheet at less than about 3 degrees says nothing useful about distance.
MIN_SINE_TO_SHEET = 0.05


def triangulate(
    camera: CameraModel, plane_in_camera: Float, position_px: npt.ArrayLike, sigma_px: npt.ArrayLike
) -> tuple[Float, Float]:
    """Points on a laser sheet, one per column.

    Args:
        camera: intrinsic model.
        plane_in_camera: (4,) n . X + d = 0.
        position_px: (w,) row of the stripe in each column, NaN where there is none.
        sigma_px: (w,) its standard deviation.

    Returns:
        points_in_camera (w, 3) and spread_in_camera (w, 3): the displacement of the point [m] that one sigma of row
        causes; NaN where there is no position, where the ray meets the sheet at a grazing angle or behind the camera.
    """
    rows = np.asarray(position_px, dtype=np.float64)
    known = np.flatnonzero(np.isfinite(rows))
    points = np.full((rows.size, 3), np.nan)
    spread = np.full((rows.size, 3), np.nan)
    if not known.size:
        return points, spread
    rays = camera.rays(np.column_stack((known, rows[known])))
    normal, offset = plane_in_camera[:3], plane_in_camera[3]
    sine = rays @ normal
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = -offset / sine
        grazing = np.abs(sine) < MIN_SINE_TO_SHEET * np.linalg.norm(rays, axis=1)
        usable = ~grazing & (depth > 0)
        points[known] = np.where(usable[:, None], rays * depth[:, None], np.nan)
        # d(depth * ray)/dv with the ray moving by 1 / fy per row (the lens stretches that by a few per cent only).
        ray_step = np.array([0.0, 1.0 / camera.matrix[1, 1], 0.0])
        slope = depth[:, None] * (ray_step - rays * (ray_step @ normal / sine)[:, None])
    spread[known] = np.where(usable[:, None], slope, np.nan) * np.asarray(sigma_px, np.float64)[known, None]
    return points, spread


def sheet_origin(planes: Float, near: Float) -> Float:
    """The point of the mirror axis nearest to `near`: all sheets pass (almost) through that line.

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
