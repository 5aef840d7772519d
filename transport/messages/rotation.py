"""Rotation matrices to unit quaternions (x, y, z, w) as ROS 2 orders them, and back."""

from __future__ import annotations

import math

import numpy as np

from transport.arrays import Float
from transport.exceptions import MessageError

Quaternion = tuple[float, float, float, float]


def quaternion_from_matrix(rotation: Float) -> Quaternion:
    """Unit quaternion (x, y, z, w), w >= 0, of a (3, 3) rotation matrix.

    The component of largest magnitude is computed first, so that no division is by a small number
    (Shepperd's method).
    """
    r = rotation
    squares = np.array(
        [
            1.0 + r[0, 0] - r[1, 1] - r[2, 2],
            1.0 - r[0, 0] + r[1, 1] - r[2, 2],
            1.0 - r[0, 0] - r[1, 1] + r[2, 2],
            1.0 + r[0, 0] + r[1, 1] + r[2, 2],
        ]
    )
    products = np.array(
        [
            [squares[0], r[0, 1] + r[1, 0], r[0, 2] + r[2, 0], r[2, 1] - r[1, 2]],
            [r[0, 1] + r[1, 0], squares[1], r[1, 2] + r[2, 1], r[0, 2] - r[2, 0]],
            [r[0, 2] + r[2, 0], r[1, 2] + r[2, 1], squares[2], r[1, 0] - r[0, 1]],
            [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], squares[3]],
        ]
    )
    row = products[int(np.argmax(squares))]
    row = row / np.linalg.norm(row)
    x, y, z, w = (row if row[3] >= 0.0 else -row).tolist()
    return x, y, z, w


def matrix_from_quaternion(quaternion: Quaternion, what: str = "rotation") -> Float:
    """The (3, 3) rotation matrix of a unit quaternion (x, y, z, w).

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
