"""Camera equations of the paper, 1 to 8: projection, placement on the robot, radial distortion."""

from __future__ import annotations

import numpy as np

from guara_perception.arrays import Float

# Fixed-point iterations of eq. 8: 8 leave < 0.001 px at the corner for k = -0.3; more cost little.
UNDISTORT_STEPS = 12


def intrinsic_matrix(alpha: float, beta: float, gamma: float, u0: float, v0: float) -> Float:
    """Matrix A of eq. 1 from scale factors, skew and principal point [px]."""
    return np.array([[alpha, gamma, u0], [0.0, beta, v0], [0.0, 0.0, 1.0]])


def project(matrix: Float, point_in_camera: Float) -> Float:
    """Pixel (u, v) of a point (3,) in the camera frame, eq. 1: rho p = A P."""
    rho_p = matrix @ point_in_camera
    return np.asarray(rho_p[:2] / rho_p[2])


def to_robot(rotation: Float, translation: Float, point_in_camera: Float) -> Float:
    """Point (3,) in the rangefinder frame, eq. 2."""
    return np.asarray(rotation @ point_in_camera + translation)


def pixel_to_robot(rotation: Float, translation: Float, matrix: Float, pixel: Float, rho: float) -> Float:
    """Point (3,) in the rangefinder frame of a pixel (2,) at depth rho, eq. 3."""
    return np.asarray(rho * rotation @ np.linalg.inv(matrix) @ np.append(pixel, 1.0) + translation)


def extrinsic_matrix(rotation: Float, translation: Float) -> Float:
    """Rotation and translation as one (4, 4), eq. 4."""
    return np.block([[rotation, translation.reshape(3, 1)], [np.zeros((1, 3)), np.ones((1, 1))]])


def rotation_of_pitch(alpha: float) -> Float:
    """Rotation of the camera at pitch alpha [rad] in the rangefinder frame, eq. 5."""
    c, s = np.cos(alpha), np.sin(alpha)
    return np.array([[0.0, c, s], [1.0, 0.0, 0.0], [0.0, s, -c]])


def translation_of_mount(d: float) -> Float:
    """Translation of a camera d ahead of the rangefinder frame's origin [m], eq. 6."""
    return np.array([d, 0.0, 0.0])


def distort(u: Float, v: Float, k: float) -> tuple[Float, Float]:
    """Radial distortion with one coefficient, eq. 7: distortion-free to distorted.

    Coordinates are relative to the principal point and divided by the focal length, otherwise k has no meaning.
    """
    factor = 1 + k * (u**2 + v**2)
    return u * factor, v * factor


def undistort(u_r: Float, v_r: Float, k: float, *, literal: bool = False) -> tuple[Float, Float]:
    """Distorted to distortion-free, eq. 8.

    r in eq. 8 is the radius of the point that is sought, so the equation is solved by iteration.

    Args:
        u_r, v_r: distorted coordinates, relative to the principal point and divided by the focal length.
        k: coefficient of eq. 7.
        literal: one iteration with the distorted radius, as the equation is printed; it leaves up to 10 px at a corner
            for k = -0.2.
    """
    u, v = u_r, v_r
    for _ in range(1 if literal else UNDISTORT_STEPS):
        factor = 1 + k * (u**2 + v**2)
        u, v = u_r / factor, v_r / factor
    return u, v
