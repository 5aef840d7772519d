"""Conversion between rotation matrices and unit quaternions."""

from __future__ import annotations

import math

import numpy as np

from transport.arrays import Float
from transport.exceptions import MessageError

Quaternion = tuple[float, float, float, float]
# Signs of each diagonal element of a rotation in 4 x^2, 4 y^2, 4 z^2 and 4 w^2.
SIGNS = np.array([[1.0, -1.0, -1.0, 1.0], [-1.0, 1.0, -1.0, 1.0], [-1.0, -1.0, 1.0, 1.0]])


def quaternion_from_matrix(rotation: Float) -> Quaternion:
    """Unit quaternion (x, y, z, w), w >= 0, of a (3, 3) rotation matrix.

    The row of 4 q q^T with the largest diagonal element is normalised; its norm is far from zero (Shepperd's method).
    """
    # products = 4 q q^T: R + R^T gives xy, xz and yz; R - R^T the products with w; the diagonal of R the squares.
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
    """Rotation matrix (3, 3) of a unit quaternion (x, y, z, w).

    Raises:
        MessageError: the quaternion is not finite or its length is not 1 within 1e-6.
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
