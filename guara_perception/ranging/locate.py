"""From a stripe profile to points in base_footprint: triangulation, and the paper's equations."""

from __future__ import annotations

from typing import Protocol

import numpy as np
import numpy.typing as npt

from guara_perception.arrays import Float, Index
from guara_perception.calibration.camera import CameraModel
from guara_perception.ranging.column_rays import ColumnRays
from guara_perception.ranging.paper.rangefinder import Literal, PaperRangefinder

# A ray that meets the laser plane at less than about 3 degrees says nothing useful about distance.
MIN_SINE_TO_PLANE = 0.05


class Locator(Protocol):
    """Finds the points of stripes, of one or of several at once; coordinate by coordinate, which is fastest."""

    @property
    def view_point(self) -> Float:
        """(3,) point in base_footprint about which heights are orthorectified: the optical centre, if all is right."""

    def points(self, plane_in_camera: Float, position_px: npt.ArrayLike, columns: Index | None = None) -> Float:
        """Points (3, ..., n) in base_footprint of stripes at these rows; NaN where there is none.

        Args:
            plane_in_camera: (..., 4) calibrated laser planes, one for each n rows.
            position_px: (..., n) rows.
            columns: (..., n) column of each row; None = every column of the picture, in order.
        """

    def measure(
        self, plane_in_camera: Float, position_px: npt.ArrayLike, sigma_px: npt.ArrayLike
    ) -> tuple[Float, Float]:
        """The same points and the standard deviations (..., w) of their heights [m]."""


class Triangulator:
    """Each ray meets the calibrated laser plane: nothing is approximated."""

    def __init__(self, camera: CameraModel, transform_camera_to_footprint: Float) -> None:
        """Prepare the rays.

        Args:
            camera: intrinsic model.
            transform_camera_to_footprint: (4, 4).
        """
        self._rays = ColumnRays(camera)
        self._per_row = 1.0 / camera.matrix[1, 1]
        self._rotation = transform_camera_to_footprint[:3, :3]
        self._translation = transform_camera_to_footprint[:3, 3]

    @property
    def view_point(self) -> Float:
        """Optical centre (3,)."""
        return np.array(self._translation)

    def points(self, plane_in_camera: Float, position_px: npt.ArrayLike, columns: Index | None = None) -> Float:
        """Points (3, ..., n) in base_footprint."""
        rays = self._rays.at(position_px, columns)
        return self._at_depth(self._directions(rays), plane_depth(rays, plane_in_camera)[0])

    def measure(
        self, plane_in_camera: Float, position_px: npt.ArrayLike, sigma_px: npt.ArrayLike
    ) -> tuple[Float, Float]:
        """Points (3, ..., w) and standard deviations (..., w) of heights [m], by the meeting point's derivative."""
        rays = self._rays.at(position_px)
        depth, along_normal = plane_depth(rays, plane_in_camera)
        directions = self._directions(rays)
        # d(depth * ray)/dv with the ray moving by 1 / fy per row (the lens stretches that by a few per cent only).
        slope = plane_in_camera[..., 1, None] / along_normal
        slope *= directions[2]
        np.subtract(self._rotation[2, 1], slope, out=slope)
        slope *= depth
        slope *= self._per_row
        slope *= np.asarray(sigma_px, dtype=np.float64)
        return self._at_depth(directions, depth), np.abs(slope)

    def _directions(self, rays: Float) -> Float:
        """Rays (3, ..., n) rotated into base_footprint.

        Term by term: a matrix product may round a point differently when there are more of them.
        """
        x, y = rays
        along_x, along_y, along_z = self._rotation.T.reshape(3, 3, *(1 for _ in x.shape))
        directions = along_x * x
        directions += along_y * y
        directions += along_z
        return np.asarray(directions)

    def _at_depth(self, directions: Float, depth: Float) -> Float:
        """Points (3, ..., n) in base_footprint at depths along directions, whose memory they take over."""
        directions *= depth
        directions += self._translation.reshape(3, *(1 for _ in depth.shape))
        return directions


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
        is_grazing = along_normal * along_normal < MIN_SINE_TO_PLANE**2 * (x * x + y * y + 1)
        unusable = is_grazing | (depth <= 0)
    if unusable.any():
        depth[unusable] = np.nan
    return depth, along_normal


def locator(
    literal: Literal | None,
    camera: CameraModel,
    transform_camera_to_footprint: Float,
    area: tuple[tuple[float, float], tuple[float, float]],
) -> Locator:
    """The paper's equations where `literal` is given, with what it takes as printed; None = triangulation."""
    if literal is None:
        return Triangulator(camera, transform_camera_to_footprint)
    return PaperRangefinder(camera, transform_camera_to_footprint, area, literal)
