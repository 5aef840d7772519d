"""Equations of the paper by number, and the chain that they form from stripe positions to points.

Lens (8), floor (9, 10), heights (16 to 19), orthorectified image (20, 21). Eqs. 1 to 7 and 11 to 13 belong to the
calibration (`CameraModel`, `surface_map`).

Eqs. 14 to 19 are exact in rectified floor coordinates (after eqs. 9 and 10): there f and the pitch drop out, v is the
position on the floor measured across the stripe, and z = H - h, where H is the height of the optical centre.

A homography does not move the optical centre, so (u0', v0') of eqs. 20 and 21 is the nadir, the point below the camera,
which usually lies outside the image. The equations are exact only about the nadir.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from guara_perception.arrays import Float
from guara_perception.calibration.calibration import CameraModel, floor_pixels, plane_in_frame
from guara_perception.calibration.surface_map import surface_map
from guara_perception.exceptions import InvalidInput

Number = float | Float
# Fixed-point iterations of eq. 8. They leave an error below 0.001 px at a radius of 0.7 focal lengths for k = -0.3.
UNDISTORT_ITERATIONS = 12
# Heights of the two virtual plates that define the constants of a stripe [m].
PLATE_HEIGHTS_M = (0.0, 0.08)
# Number of columns and rows of pixels at which the single radial coefficient is fitted to the calibrated lens.
LENS_GRID = (17, 13)
# Distance of the four marks from the border of the surface, as a fraction of its extent. With this distance, the
# distortion that one coefficient cannot model is about as large inside the marks as outside. With marks in the corners,
# the mean error of the recorded scans is 0.66 mm instead of 0.46 mm.
MARK_INSET = 0.2
# Offset of rows for the finite difference that gives the sigma of a height [px].
DIFFERENCE_PX = 0.5


def undistort(u_r: Float, v_r: Float, k: float, *, literal: bool = False) -> tuple[Float, Float]:
    """Convert distorted coordinates to undistorted ones, eq. 8.

    r in eq. 8 is the undistorted radius, so the equation is solved by iteration.

    Args:
        u_r, v_r: distorted coordinates, relative to the principal point and divided by the focal length.
        k: coefficient of eq. 7.
        literal: True for one iteration with the distorted radius, as the equation is printed; its error is up to 10 px
            at a corner for k = -0.2.
    """
    u, v = u_r, v_r
    for _ in range(1 if literal else UNDISTORT_ITERATIONS):
        factor = 1 + k * (u**2 + v**2)
        u, v = u_r / factor, v_r / factor
    return u, v


def surface_x(coefficients: Float, u: Float, v: Float) -> Float:
    """Floor x, eq. 9, from coefficients a ... i (9,)."""
    a, b, c, _, _, _, g, h, i = coefficients
    return np.asarray((a * u + b * v + c) / (g * u + h * v + i))


def surface_y(coefficients: Float, u: Float, v: Float) -> Float:
    """Floor y, eq. 10, from coefficients a ... i (9,)."""
    _, _, _, d, e, f, g, h, i = coefficients
    return np.asarray((d * u + e * v + f) / (g * u + h * v + i))


@dataclass(frozen=True, slots=True)
class StripeConstants:
    """Constants n, d and k of a stripe, eqs. 17 and 18; arrays of one shape for several stripes."""

    n: Number
    d: Number
    k: Number


def stripe_constants(v1: Number, z1: float, v2: Number, z2: float) -> StripeConstants:
    """Constants of stripes from two calibrated points of each, as defined at eqs. 16 and 17.

    Raises:
        InvalidInput: the depths are equal, or a stripe has the same position at both: eq. 17 is singular.
    """
    if z1 == z2 or np.any(v1 == v2):
        raise InvalidInput(f"eq. 17 needs two depths and two positions, not z = {z1}, {z2} and v = {v1}, {v2}")
    return StripeConstants(n=z1 * z2 * (v1 - v2), d=z2 - z1, k=v2 * z2 - v1 * z1)


def depth_from_constants(v: Float, constants: StripeConstants) -> Float:
    """Depth z of points of a stripe seen at v, eq. 18; NaN at the pole of the equation and beyond it."""
    below = v * constants.d - constants.k
    with np.errstate(divide="ignore", invalid="ignore"):
        z = constants.n / below
    return np.asarray(np.where(np.isfinite(z) & (z > 0), z, np.nan))


def height(z: Float, h_m: float, alpha: float = 0.0) -> Float:
    """Height of a point at depth z, eq. 19: h = h_m - z cos(alpha); alpha = 0 in rectified coordinates."""
    return np.asarray(h_m - z * np.cos(alpha))


def ortho_u(u: Float, h: Float, camera_height: float, u0: float) -> Float:
    """Position u in the orthorectified image, eq. 20; the u0 printed in its first term must be u0', as in eq. 21.

    Args:
        u: position in the perspective range image.
        h: height of the surface at this position.
        camera_height: height H of the optical centre above the floor.
        u0: coordinate u0' of the nadir.
    """
    return np.asarray((u - u0) * (camera_height - h) / camera_height + u0)


def ortho_v(v: Float, h: Float, camera_height: float, v0: float) -> Float:
    """Position v in the orthorectified image, eq. 21; `v0` is the coordinate v0' of the nadir."""
    return np.asarray((v - v0) * (camera_height - h) / camera_height + v0)


@dataclass(frozen=True, slots=True)
class Literal:
    """Equations that are used as printed although they are wrong, to show the difference.

    Attributes:
        lens: True to solve eq. 8 in one iteration.
        ortho: True to apply eqs. 20 and 21 about the centre of the area instead of the nadir.
    """

    lens: bool = False
    ortho: bool = False


class PaperRangefinder:
    """Points of stripes by the paper's equations, with constants derived from a calibration for one stance.

    Attributes:
        view_point: (3,) point in base_footprint about which the image is orthorectified: the optical centre, or with
            `Literal.ortho` the centre of the area at the height of the optical centre.
    """

    def __init__(
        self,
        camera: CameraModel,
        transform_camera_to_footprint: Float,
        area: tuple[tuple[float, float], tuple[float, float]],
        literal: Literal,
    ) -> None:
        """Fit the lens coefficient and the surface map.

        Args:
            camera: intrinsic model, whose distortion is reduced to one radial coefficient, as in eq. 8.
            transform_camera_to_footprint: (4, 4) pose of the camera.
            area: x and y range of the surface [m], which contains the four marks.
            literal: equations that are used as printed.
        """
        self._camera = camera
        self._transform = transform_camera_to_footprint
        self._literal = literal
        self._lens_k = radial_coefficient(camera)
        (x0, x1), (y0, y1) = ((low + MARK_INSET * (high - low), high - MARK_INSET * (high - low)) for low, high in area)
        marks = np.array([(x0, y0), (x0, y1), (x1, y1), (x1, y0)])
        self._coefficients = surface_map(self._undistorted_marks(marks), marks).homography.ravel()
        self._camera_height = float(transform_camera_to_footprint[2, 3])
        self.view_point = transform_camera_to_footprint[:3, 3].copy()
        if literal.ortho:
            self.view_point[:2] = (marks[0] + marks[2]) / 2

    def stripe(self, plane_in_camera: Float) -> tuple[StripeConstants, Float]:
        """Constants of stripes, and the horizontal unit vectors (..., 2) along which v is measured.

        The paper's stripes are parallel to the rows of its image. A real stripe is slightly rotated, so v is measured
        across the stripe itself, which keeps eqs. 17 and 18 exact.

        Args:
            plane_in_camera: (..., 4) calibrated laser planes.
        """
        # One by one, because the rounding of a matrix product may depend on the number of planes.
        planes = [plane_in_frame(plane, self._transform) for plane in plane_in_camera.reshape(-1, 4)]
        nx, ny, nz, d = np.reshape(planes, plane_in_camera.shape).transpose(-1, *range(plane_in_camera.ndim - 1))
        steepness = np.hypot(nx, ny)
        across = np.stack((nx, ny), axis=-1) / steepness[..., None]
        z = [self._camera_height - h for h in PLATE_HEIGHTS_M]
        nadir = across[..., 0] * self._transform[0, 3] + across[..., 1] * self._transform[1, 3]
        # Intersection of the laser plane with each plate, projected from the optical centre onto the floor.
        v = [
            nadir + (-(nz * h + d) / steepness - nadir) * self._camera_height / (self._camera_height - h)
            for h in PLATE_HEIGHTS_M
        ]
        return stripe_constants(v[0], z[0], v[1], z[1]), across

    def points(self, plane_in_camera: Float, rows: Float) -> Float:
        """Points (3, ..., w) in base_footprint of stripes at rows (..., w) of all image columns; NaN without a point.

        Args:
            plane_in_camera: (..., 4) calibrated laser planes, one for each set of w rows.
            rows: (..., w) row at which the stripe was found in each column.
        """
        matrix = self._camera.matrix
        u_r = (np.arange(rows.shape[-1]) - matrix[0, 2]) / matrix[0, 0]
        v_r = (rows - matrix[1, 2]) / matrix[1, 1]
        u, v = undistort(u_r, v_r, self._lens_k, literal=self._literal.lens)
        x, y = surface_x(self._coefficients, u, v), surface_y(self._coefficients, u, v)
        constants, across = self.stripe(plane_in_camera[..., None, :])
        h = height(depth_from_constants(across[..., 0] * x + across[..., 1] * y, constants), self._camera_height)
        x0, y0, z0 = self.view_point
        return np.stack((ortho_v(x, h, z0, x0), ortho_u(y, h, z0, y0), h))

    def measure(
        self, plane_in_camera: Float, position_px: npt.ArrayLike, sigma_px: npt.ArrayLike
    ) -> tuple[Float, Float]:
        """Points as from `points`, and standard deviations (..., w) of their heights [m] due to `sigma_px`."""
        rows = np.asarray(position_px, dtype=np.float64)
        above = self.points(plane_in_camera, rows - DIFFERENCE_PX)[2]
        below = self.points(plane_in_camera, rows + DIFFERENCE_PX)[2]
        sigma = np.abs(below - above) / (2 * DIFFERENCE_PX) * np.asarray(sigma_px, dtype=np.float64)
        return self.points(plane_in_camera, rows), sigma

    def _undistorted_marks(self, marks: Float) -> Float:
        """Image coordinates (n, 2) of floor marks (n, 2), distorted by the calibrated lens and undistorted by eq. 8.

        The surface map thus compensates at the marks for the distortion that one radial coefficient cannot model.
        """
        matrix = self._camera.matrix
        seen = (floor_pixels(self._camera, self._transform, marks) - matrix[:2, 2]) / np.diag(matrix)[:2]
        return np.column_stack(undistort(seen[:, 0], seen[:, 1], self._lens_k, literal=self._literal.lens))


def radial_coefficient(camera: CameraModel) -> float:
    """Coefficient k of eq. 7 that fits the calibrated lens best over the image (least squares)."""
    u = np.linspace(0, camera.size[0] - 1, LENS_GRID[0])
    v = np.linspace(0, camera.size[1] - 1, LENS_GRID[1])
    pixels = np.array([(a, b) for b in v for a in u])
    free = camera.rays(pixels)[:, :2]
    seen = (pixels - camera.matrix[:2, 2]) / np.diag(camera.matrix)[:2]
    # Eq. 7 is linear in k: seen - free = k r^2 free.
    bend = free * (free**2).sum(axis=1, keepdims=True)
    return float((bend * (seen - free)).sum() / max(float((bend**2).sum()), 1e-12))
