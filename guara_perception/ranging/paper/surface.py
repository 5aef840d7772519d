"""Surface map of the paper, eqs. 9 to 13: from distortion-free image coordinates to the floor by four marks."""

from __future__ import annotations

import numpy as np

from guara_perception.arrays import Float
from guara_perception.exceptions import InvalidInput

# Above this condition number of the 8 x 8 system the marks as good as lie on one line.
LARGEST_CONDITION = 1e8


def surface_x(coefficients: Float, u: Float, v: Float) -> Float:
    """Floor x, eq. 9, from coefficients a ... i (9,)."""
    a, b, c, _, _, _, g, h, i = coefficients
    return np.asarray((a * u + b * v + c) / (g * u + h * v + i))


def surface_y(coefficients: Float, u: Float, v: Float) -> Float:
    """Floor y, eq. 10, from coefficients a ... i (9,)."""
    _, _, _, d, e, f, g, h, i = coefficients
    return np.asarray((d * u + e * v + f) / (g * u + h * v + i))


def x_row(u: float, v: float, x: float) -> Float:
    """Row of one mark for its x, eq. 11: row . (a ... h) = x."""
    return np.array([u, v, 1.0, 0.0, 0.0, 0.0, -u * x, -v * x])


def y_row(u: float, v: float, y: float) -> Float:
    """Row of one mark for its y, eq. 12: row . (a ... h) = y."""
    return np.array([0.0, 0.0, 0.0, u, v, 1.0, -u * y, -v * y])


def surface_coefficients(pixels: Float, points: Float) -> Float:
    """Coefficients a ... i (9,) of the map through four marks, eq. 13 with i = 1.

    Args:
        pixels: (4, 2) distortion-free image coordinates.
        points: (4, 2) their positions on the floor [m].

    Raises:
        InvalidInput: not four marks, or three of them on one line.
    """
    pixels, points = np.asarray(pixels, np.float64), np.asarray(points, np.float64)
    if pixels.shape != (4, 2) or points.shape != (4, 2):
        raise InvalidInput(f"eq. 13 takes four marks: pixels are {pixels.shape}, points {points.shape}, not (4, 2)")
    matrix = np.array(
        [x_row(u, v, x) for (u, v), (x, _) in zip(pixels, points, strict=True)]
        + [y_row(u, v, y) for (u, v), (_, y) in zip(pixels, points, strict=True)]
    )
    if not np.linalg.cond(matrix) < LARGEST_CONDITION:
        raise InvalidInput("three of the four marks lie on one line: eq. 13 has no single solution")
    return np.append(np.linalg.solve(matrix, np.concatenate((points[:, 0], points[:, 1]))), 1.0)
