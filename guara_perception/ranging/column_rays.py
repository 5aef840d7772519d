"""Viewing rays at a row of every image column, by a polynomial for each column in place of the lens model."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numpy.polynomial import chebyshev

from guara_perception.arrays import Float, Index
from guara_perception.calibration.camera import CameraModel

# Numbers of coefficients, tried in this order. A usual lens needs 16; one whose distortion is not monotonic near a
# corner of the picture needs more.
COUNTS = (16, 24)
# Largest error of a ray at the points where it is checked, projected into the picture [px]: a triangulated point is
# then right to a few nm.
TOLERANCE_PX = 1e-6


class ColumnRays:
    """Rays of one camera, as `CameraModel.rays` gives them to some millionths of a pixel, in a fraction of the time."""

    def __init__(self, camera: CameraModel) -> None:
        """Fit the polynomials; where none fits the lens, `at` computes each ray with the camera model itself."""
        self._camera = camera
        self._centre_row = (camera.size[1] - 1) / 2
        self._coefficients = next((c for n in COUNTS if (c := _fitted(camera, n)) is not None), None)

    def at(self, rows: npt.ArrayLike, columns: Index | None = None) -> Float:
        """Rays (2, ..., n): x and y in the camera frame at z = 1, NaN where the row is NaN.

        Args:
            rows: (..., n) sub-pixel rows.
            columns: (..., n) whole columns; None = every column of the picture, in order.
        """
        rows = np.asarray(rows, dtype=np.float64)
        if self._coefficients is None:
            return self._exact(rows, np.arange(rows.shape[-1]) if columns is None else columns)
        scaled = rows / self._centre_row - 1
        coefficients = self._coefficients if columns is None else self._coefficients.take(columns, axis=2)
        for _ in range(2 + scaled.ndim - coefficients.ndim):
            coefficients = coefficients[:, :, None]
        # Horner's scheme.
        rays = coefficients[0] * scaled
        for coefficient in coefficients[1:-1]:
            rays += coefficient
            rays *= scaled
        rays += coefficients[-1]
        return np.asarray(rays)

    def _exact(self, rows: Float, columns: Index) -> Float:
        known = np.isfinite(rows)
        rays = np.full((2, *rows.shape), np.nan)
        pixels = np.column_stack((np.broadcast_to(columns, rows.shape)[known], rows[known]))
        rays[:, known] = self._camera.rays(pixels)[:, :2].T
        return rays


def _fitted(camera: CameraModel, count: int) -> Float | None:
    """Coefficients (count, 2, width), highest power first, of rows scaled to -1 ... 1; None when they do not fit.

    The polynomials interpolate the rays at Chebyshev nodes along columns and rows, which is near the best fit there is.
    The error is checked at other points than the nodes, `between` and beyond them.
    """
    nodes, between = chebyshev.chebpts1(count), chebyshev.chebpts2(count)
    inverse = np.linalg.inv(chebyshev.chebvander(nodes, count - 1))
    terms = inverse @ _rays(camera, nodes) @ inverse.T
    check = chebyshev.chebvander(between, count - 1)
    error = np.abs(check @ terms @ check.T - _rays(camera, between)).max()
    if not error * max(camera.matrix[0, 0], camera.matrix[1, 1]) < TOLERANCE_PX:
        return None
    # From Chebyshev polynomials to powers, which Horner's scheme in `at` evaluates quickest.
    powers = np.linalg.solve(np.vander(nodes, count), chebyshev.chebvander(nodes, count - 1))
    per_column = (powers @ terms) @ chebyshev.chebvander(np.linspace(-1, 1, camera.size[0]), count - 1).T
    return np.ascontiguousarray(per_column.swapaxes(0, 1))


def _rays(camera: CameraModel, scaled: Float) -> Float:
    """Exact rays (2, n, n), at rows and columns that both take the values `scaled` (n,), -1 ... 1 over the picture."""
    (columns, rows) = ((scaled + 1) / 2 * (size - 1) for size in camera.size)
    pixels = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    return camera.rays(pixels)[:, :2].T.reshape(2, scaled.size, scaled.size)
