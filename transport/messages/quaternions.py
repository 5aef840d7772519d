"""Conversion between rotation matrices and unit quaternions."""

from __future__ import annotations

import math

import numpy as np

from transport.arrays import Float
from transport.exceptions import MessageError

Quaternion = tuple[float, float, float, float]
# Sign of each diagonal element of a rotation matrix in 4 x^2, 4 y^2, 4 z^2 and 4 w^2.
SIGNS = np.array([[1.0, -1.0, -1.0, 1.0], [-1.0, 1.0, -1.0, 1.0], [-1.0, -1.0, 1.0, 1.0]])


def quaternion_from_matrix(rotation: Float) -> Quaternion:
    """Convert a (3, 3) rotation matrix to a unit quaternion (x, y, z, w) with w >= 0.

    The result is the row of 4 q q^T with the largest diagonal element, normalised (Shepperd's method). The norm of this
    row is at least 2.
    """
    # products = 4 q q^T: R + R^T gives xy, xz and yz; R - R^T gives the products with w; the diagonal of R gives the
    # squares.
    products = np.empty((4, 4))
    products[:3, :3] = rotation + rotation.T
    turn = rotation - rotation.T
    products[3, :3] = products[:3, 3] = turn[2, 1], turn[0, 2], turn[1, 0]
    a, b, c = np.diag(rotation)
    np.fill_diagonal(products, 1.0 + a * SIGNS[0] + b * SIGNS[1] + c * SIGNS[2])
    row = products[int(np.argmax(np.diag(products)))]
    row = row / np.linalg.norm(row)
    x, y, z, w = (row if row[3] >= 0.0 else -row).tolist()
    return x, y, z, w


def matrix_from_quaternion(quaternion: Quaternion, what: str = "rotation") -> Float:
    """Convert a unit quaternion (x, y, z, w) to a (3, 3) rotation matrix.

    Raises:
        MessageError: the quaternion is not finite, or its length differs from 1 by more than 1e-6.
    """
    length = math.hypot(*quaternion)
    if not math.isfinite(length) or abs(length - 1.0) > 1e-6:
        raise MessageError(f"quaternion of {what} has length {length}; a unit quaternion is needed")
    x, y, z, w = (component / length for component in quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
