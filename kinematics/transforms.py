"""Rigid transforms as (4, 4) matrices: inverse, application to points, and validation of arguments."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from kinematics.arrays import Float
from kinematics.exceptions import ArgumentError

# Tolerance of the elements of R R' - I: error of a rotation written with seven digits.
ROTATION_TOLERANCE = 1e-6
# Tolerance of the last row: rounding error of a general matrix inverse.
LAST_ROW_TOLERANCE = 1e-9


def translation(vector: npt.ArrayLike) -> Float:
    """Transform (4, 4) that only translates, by a vector (3,)."""
    result = np.eye(4)
    result[:3, 3] = vector
    return result


def inverse(transform: Float) -> Float:
    """Inverse of a rigid transform (4, 4)."""
    result = np.eye(4)
    result[:3, :3] = transform[:3, :3].T
    result[:3, 3] = -transform[:3, :3].T @ transform[:3, 3]
    return result


def transform_points(transform: Float, points: npt.ArrayLike) -> Float:
    """Apply a transform (4, 4) to points (..., 3) [m]."""
    return np.asarray(np.asarray(points, dtype=np.float64) @ transform[:3, :3].T + transform[:3, 3])


def checked_points(value: npt.ArrayLike, name: str, shape: str = "(..., 3)") -> Float:
    """Convert an argument to an array of points and check its shape, "(n, 3)" or "(..., 3)".

    Raises:
        ArgumentError: the argument has another shape; the message contains `name`.
    """
    points = np.asarray(value, dtype=np.float64)
    if points.ndim < 1 or points.shape[-1] != 3 or (shape == "(n, 3)" and points.ndim != 2):
        raise ArgumentError(f"{name} has shape {points.shape}; {shape} is needed")
    return points


def checked_transform(value: npt.ArrayLike, name: str) -> Float:
    """Copy an argument to an array and check that it is a rigid transform (4, 4).

    Raises:
        ArgumentError: the matrix has the wrong shape, is not finite, contains no rotation, or has a last row other than
            0 0 0 1; the message contains `name`.
    """
    transform = np.array(value, dtype=np.float64)
    if transform.shape != (4, 4) or not np.all(np.isfinite(transform)):
        fault = "a value that is not finite" if transform.shape == (4, 4) else f"shape {transform.shape}"
        raise ArgumentError(f"{name} has {fault}; a finite (4, 4) matrix is needed")
    rotation = transform[:3, :3]
    error, determinant = np.abs(rotation @ rotation.T - np.eye(3)).max(), np.linalg.det(rotation)
    if error > ROTATION_TOLERANCE or determinant < 0.0:
        raise ArgumentError(f"{name} contains no rotation: R R' - I is up to {error:.2g}, det R is {determinant:.2g}")
    if np.abs(transform[3] - [0.0, 0.0, 0.0, 1.0]).max() > LAST_ROW_TOLERANCE:
        raise ArgumentError(f"{name} ends in the row {transform[3].tolist()}; 0 0 0 1 is needed")
    return transform


def checked_covariance(value: npt.ArrayLike, name: str) -> Float:
    """Copy an argument to an array and check that it is a covariance (6, 6).

    Raises:
        ArgumentError: the matrix has the wrong shape, is not finite or not symmetric, or has a negative eigenvalue; the
            message contains `name`.
    """
    covariance = np.array(value, dtype=np.float64)
    if covariance.shape != (6, 6) or not np.all(np.isfinite(covariance)):
        fault = "a value that is not finite" if covariance.shape == (6, 6) else f"shape {covariance.shape}"
        raise ArgumentError(f"{name} has {fault}; a finite (6, 6) matrix is needed")
    scale = max(float(np.abs(covariance).max()), np.finfo(float).tiny)
    if np.abs(covariance - covariance.T).max() > 1e-9 * scale:
        raise ArgumentError(f"{name} is not symmetric")
    if np.linalg.eigvalsh(covariance)[0] < -1e-9 * scale:
        raise ArgumentError(f"{name} has a negative eigenvalue: it is not a covariance")
    return covariance


def unit_vector(vector: npt.ArrayLike) -> Float:
    """Scale a vector to length 1; it must be finite and not zero."""
    scaled = np.asarray(vector, dtype=np.float64)
    # Squares of components above 1e154 would overflow.
    scaled = scaled / np.abs(scaled).max()
    return np.asarray(scaled / np.linalg.norm(scaled))
