"""Points of stripe profiles in `base_footprint`, by triangulation or by the paper's equations."""

from __future__ import annotations

import copy
from functools import lru_cache

import numpy as np
import numpy.typing as npt
from numpy.polynomial import chebyshev

from guara_perception.arrays import Float
from guara_perception.calibration.calibration import CameraModel
from guara_perception.ranging.paper import Literal, PaperRangefinder
from guara_perception.stripes.kernel.library import address, addresses, kernel
from kinematics.arrays import read_only

# Sine of the angle between ray and laser plane (about 3 degrees) below which the distance is too uncertain.
MIN_SINE_TO_PLANE = 0.05
# Numbers of polynomial coefficients, tried in this order. A typical lens needs 16; a lens whose distortion is not
# monotonic near a corner of the image needs more.
COUNTS = (16, 24)
# Largest error of a ray, projected into the image, at the points where the polynomials are checked [px]. The error of
# triangulated points is then a few nm.
TOLERANCE_PX = 1e-6


class Triangulator:
    """Intersection of the camera's rays with the calibrated laser planes; the rays are accurate to TOLERANCE_PX.

    Attributes:
        view_point: (3,) optical centre in base_footprint.
    """

    def __init__(self, camera: CameraModel, transform_camera_to_footprint: Float) -> None:
        """Prepare the rays.

        Args:
            camera: intrinsic model.
            transform_camera_to_footprint: (4, 4) pose of the camera.
        """
        self._camera = camera
        self._per_row = 1.0 / camera.matrix[1, 1]
        # Polynomials take (row - centre) / centre: -1 in the first row, 1 in the last.
        self._centre_row = (camera.size[1] - 1) / 2
        self._coefficients = _coefficients(camera.size, camera.matrix.tobytes(), camera.distortion.tobytes())
        self._place(transform_camera_to_footprint)

    def _place(self, transform_camera_to_footprint: Float) -> None:
        self._pose = np.ascontiguousarray(transform_camera_to_footprint[:3], np.float64)
        self.view_point = np.array(transform_camera_to_footprint[:3, 3])

    def at(self, transform_camera_to_footprint: Float) -> Triangulator:
        """Return a triangulator for the same camera at another pose (4, 4)."""
        other = copy.copy(self)
        other._place(transform_camera_to_footprint)
        return other

    def measure(
        self, plane_in_camera: Float, position_px: npt.ArrayLike, sigma_px: npt.ArrayLike
    ) -> tuple[Float, Float]:
        """Locate stripes found at given rows of all image columns.

        Args:
            plane_in_camera: (..., 4) calibrated laser planes, one for each set of w rows.
            position_px: (..., w) row in each column; NaN where the stripe was not found.
            sigma_px: (..., w) standard deviations of these rows.

        Returns:
            Points (3, ..., w) in base_footprint [m], NaN where there is no row, or where the ray meets the plane at a
            grazing angle or behind the camera; and standard deviations (..., w) of their heights [m], propagated to
            first order.
        """
        # d(depth R r)_z / dv = depth / fy * (R_zy - (R r)_z n_y / (n . r)); the change
        # of 1 / fy due to lens distortion, a few per cent, is neglected.
        rows, sigma, planes = (np.ascontiguousarray(v, np.float64) for v in (position_px, sigma_px, plane_in_camera))
        points, deviation = np.empty((3, *rows.shape)), np.empty(rows.shape)
        size = rows.size // rows.shape[-1], rows.shape[-1]
        rays, terms = self._rays(rows)
        given = *addresses(rows, sigma), *size, address(rays), terms, self._centre_row, address(planes)
        pose = address(self._pose), self._per_row, MIN_SINE_TO_PLANE
        kernel().locate(*given, *pose, *addresses(points, deviation))
        return points, deviation

    def _rays(self, rows: Float) -> tuple[Float, int]:
        """Coefficients (terms, 2, w) of the rays of all columns, and their number, as the kernel takes them.

        If no polynomials fit the lens, the exact rays (2, ..., w) at rows (..., w), and 0.
        """
        if self._coefficients is not None:
            return self._coefficients, len(self._coefficients)
        known = np.isfinite(rows)
        rays = np.full((2, *rows.shape), np.nan)
        columns = np.broadcast_to(np.arange(rows.shape[-1]), rows.shape)
        rays[:, known] = self._camera.rays(np.column_stack((columns[known], rows[known])))[:, :2].T
        return rays, 0


Locator = Triangulator | PaperRangefinder


def locator(
    literal: Literal | None,
    camera: CameraModel,
    transform_camera_to_footprint: Float,
    area: tuple[tuple[float, float], tuple[float, float]],
) -> Locator:
    """Return a locator by the paper's equations if `literal` is given, by triangulation if it is None."""
    if literal is None:
        return Triangulator(camera, transform_camera_to_footprint)
    return PaperRangefinder(camera, transform_camera_to_footprint, area, literal)


@lru_cache(maxsize=2)
def _coefficients(size: tuple[int, int], matrix: bytes, distortion: bytes) -> Float | None:
    """Coefficients as from `_fitted`, None if none fit the lens; cached, since the next scan has the same camera."""
    camera = CameraModel(size, np.frombuffer(matrix).reshape(3, 3), np.frombuffer(distortion))
    return next((read_only(c) for n in COUNTS if (c := _fitted(camera, n)) is not None), None)


def _fitted(camera: CameraModel, count: int) -> Float | None:
    """Coefficients (count, 2, width), highest power first, for rows scaled to -1 ... 1; None if the fit is too coarse.

    The polynomials interpolate the rays at Chebyshev nodes along columns and rows, which is close to the best uniform
    fit. The error is checked at other points between and beyond the nodes.
    """
    nodes, between = chebyshev.chebpts1(count), chebyshev.chebpts2(count)
    inverse = np.linalg.inv(chebyshev.chebvander(nodes, count - 1))
    terms = inverse @ _rays(camera, nodes) @ inverse.T
    check = chebyshev.chebvander(between, count - 1)
    error = np.abs(check @ terms @ check.T - _rays(camera, between)).max()
    if not error * max(camera.matrix[0, 0], camera.matrix[1, 1]) < TOLERANCE_PX:
        return None
    # From Chebyshev polynomials to powers, for Horner's scheme in the kernel.
    powers = np.linalg.solve(np.vander(nodes, count), chebyshev.chebvander(nodes, count - 1))
    per_column = (powers @ terms) @ chebyshev.chebvander(np.linspace(-1, 1, camera.size[0]), count - 1).T
    return np.ascontiguousarray(per_column.swapaxes(0, 1))


def _rays(camera: CameraModel, scaled: Float) -> Float:
    """Exact rays (2, n, n) at a grid of rows and columns, both `scaled` (n,) to -1 ... 1 over the image."""
    (columns, rows) = ((scaled + 1) / 2 * (size - 1) for size in camera.size)
    pixels = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    return camera.rays(pixels)[:, :2].T.reshape(2, scaled.size, scaled.size)
