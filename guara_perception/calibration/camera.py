"""The camera model: pinhole with Brown distortion, from pixels to rays and back."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
import numpy.typing as npt

from guara_perception.arrays import Float
from guara_perception.exceptions import InvalidInput
from guara_perception.readonly import readonly

# 8 fixed-point iterations leave < 0.001 px at the corner for k1 = -0.3; 30 cost little and reach rounding.
UNDISTORT_STEPS = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 30, 1e-10)

# What is nearer lies in the lens or behind it.
NEAREST_DEPTH_M = 1e-6
# Points that are projected at once: few enough that intermediate results stay in the processor's cache.
BLOCK = 2048


# Wider than any camera here; what is computed for each pixel must fit into memory.
LARGEST_SIDE_PX = 8192


@dataclass(frozen=True, slots=True)
class CameraModel:
    """Intrinsic calibration, eq. 1 of the paper with the lens model that OpenCV uses.

    Attributes:
        size: image width and height [px].
        matrix: (3, 3) float64, focal lengths and principal point [px].
        distortion: (5,) float64, k1, k2, p1, p2, k3.
    """

    size: tuple[int, int]
    matrix: Float
    distortion: Float

    def __post_init__(self) -> None:
        """Check and freeze."""
        matrix = readonly(np.array(self.matrix, dtype=np.float64))
        distortion = readonly(np.array(self.distortion, dtype=np.float64).ravel())
        if len(self.size) != 2 or not all(16 <= n <= LARGEST_SIDE_PX and n == int(n) for n in self.size):
            raise InvalidInput(
                f"camera size is {tuple(n if n != int(n) else int(n) for n in self.size)}, it must be (width, height), "
                f"whole and each 16 to {LARGEST_SIDE_PX} px"
            )
        if matrix.shape != (3, 3) or not np.isfinite(matrix).all():
            raise InvalidInput(f"camera matrix has shape {matrix.shape}, it must be 3x3 and finite")
        if matrix[0, 0] <= 0 or matrix[1, 1] <= 0 or not np.allclose(matrix[2], (0, 0, 1)):
            raise InvalidInput("camera matrix must have positive focal lengths and a last row of 0 0 1")
        if matrix[0, 1] != 0 or matrix[1, 0] != 0:
            raise InvalidInput("camera matrix has a skew, the camera model does not: elements 01 and 10 must be 0")
        if distortion.shape != (5,) or not np.isfinite(distortion).all():
            raise InvalidInput(
                f"camera distortion has {distortion.size} values, it must be 5 finite ones (k1, k2, p1, p2, k3)"
            )
        object.__setattr__(self, "size", (int(self.size[0]), int(self.size[1])))
        object.__setattr__(self, "matrix", matrix)
        object.__setattr__(self, "distortion", distortion)

    def rays(self, points_px: npt.ArrayLike) -> Float:
        """Viewing rays of pixels, (n, 3) float64 in the camera frame with z = 1 (eq. 3 with rho the depth).

        Args:
            points_px: (n, 2) pixel positions (u, v) as delivered by the camera, distorted.
        """
        points = np.ascontiguousarray(points_px, dtype=np.float64).reshape(-1, 1, 2)
        if not len(points):
            return np.empty((0, 3))
        flat = cv2.undistortPoints(points, self.matrix, self.distortion, criteria=UNDISTORT_STEPS)[:, 0]
        return np.column_stack((flat, np.ones(len(flat))))

    def project(self, points_in_camera: npt.ArrayLike) -> Float:
        """Pixels (n, 2) of points (n, 3) in the camera frame, with distortion; NaN behind the camera or past the fold.

        The Brown model folds back far outside the picture: there a point would land inside it again. Such points
        are recognised by the radius at which the distorted radius stops growing.
        """
        points = np.asarray(points_in_camera, dtype=np.float64).reshape(-1, 3)
        pixels = np.empty((len(points), 2))
        for start in range(0, len(points), BLOCK):
            part = slice(start, start + BLOCK)
            pixels[part] = self._project(np.ascontiguousarray(points[part].T)).T
        return pixels

    def _project(self, points: Float) -> Float:
        """Pixels (2, n) of points (3, n): coordinates in rows, several times faster than cv2.projectPoints."""
        depth = np.where(points[2] > NEAREST_DEPTH_M, points[2], np.nan)
        x, y = points[:2] / depth
        radius = x * x + y * y
        k1, k2, p1, p2, k3 = self.distortion
        with np.errstate(over="ignore", invalid="ignore"):
            stretch = 1 + radius * (k1 + radius * (k2 + radius * k3))
            twist = 2 * x * y
            u = x * stretch + p1 * twist + p2 * (radius + 2 * x * x)
            v = y * stretch + p1 * (radius + 2 * y * y) + p2 * twist
            is_folded = ~(radius < self.fold_radius() ** 2)
        pixels = np.empty((2, depth.size))
        pixels[0] = self.matrix[0, 0] * u + self.matrix[0, 2]
        pixels[1] = self.matrix[1, 1] * v + self.matrix[1, 2]
        pixels[:, is_folded] = np.nan
        return pixels

    def fold_radius(self) -> float:
        """Undistorted radius (tangent of the field angle) beyond which the radial model is no longer monotone."""
        k1, k2, _, _, k3 = self.distortion.tolist()
        return _fold_radius(k1, k2, k3)


@lru_cache(maxsize=16)
def _fold_radius(k1: float, k2: float, k3: float) -> float:
    radius = np.linspace(0.0, 4.0, 2001)
    growth = 1 + 3 * k1 * radius**2 + 5 * k2 * radius**4 + 7 * k3 * radius**6
    falling = np.flatnonzero(growth <= 0)
    return float(radius[falling[0]]) if falling.size else np.inf
