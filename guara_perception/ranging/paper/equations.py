"""The equations of the paper, each under its number: camera (1 to 8), surface map, heights, orthorectification.

In rectified floor coordinates (after eqs. 9 and 10) eqs. 14 to 19 are exact: there f and the pitch drop out, v is the
position on the floor measured across the stripe and z = H - h, with H the height of the optical centre.

A homography does not move the optical centre, so (u0', v0') of eqs. 20 and 21 is the nadir, the spot below the camera,
which usually lies outside the picture; only about the nadir the equations are exact.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from guara_perception.arrays import Float
from guara_perception.exceptions import InvalidInput

# Fixed-point iterations of eq. 8: 8 leave < 0.001 px at the corner for k = -0.3; more cost little.
UNDISTORT_ITERATIONS = 12
# Above this condition number of the 8 x 8 system three of the marks practically lie on one line.
LARGEST_CONDITION = 1e8

Number = float | Float


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


@dataclass(frozen=True, slots=True)
class StripeConstants:
    """The three constants of one stripe, eqs. 17 and 18, or of several in arrays of one shape."""

    n: Number
    d: Number
    k: Number


def focal_length(v: float, z: float, y: float) -> float:
    """Focal length from one point of the stripe, eq. 14: f = v z / y."""
    return v * z / y


def line_y(z: float, y1: float, z1: float, y2: float, z2: float) -> float:
    """Position y of the laser's line at depth z through two of its points, eq. 15."""
    return y1 + (y2 - y1) * (z - z1) / (z2 - z1)


def line_residual(v: float, z: float, v1: float, z1: float, v2: float, z2: float) -> float:
    """Residual of a point (v, z) from the laser's line in image terms, eq. 16 cross-multiplied; 0 on the line."""
    return (v * z - v1 * z1) * (z2 - z1) - (v2 * z2 - v1 * z1) * (z - z1)


def depth(v: float, v1: float, z1: float, v2: float, z2: float) -> float:
    """Depth z of a point of the stripe seen at v, eq. 17, from two calibrated points (v1, z1) and (v2, z2)."""
    return z1 * z2 * (v1 - v2) / (v * (z2 - z1) + v1 * z1 - v2 * z2)


def stripe_constants(v1: Number, z1: float, v2: Number, z2: float) -> StripeConstants:
    """Constants n, d and k of stripes from two calibrated points of each, as defined at eqs. 16 and 17.

    Raises:
        InvalidInput: equal depths, or a stripe that does not move between them: eq. 17 is singular.
    """
    if z1 == z2 or np.any(v1 == v2):
        raise InvalidInput(f"eq. 17 needs two depths and two positions, given z = {z1}, {z2} and v = {v1}, {v2}")
    return StripeConstants(n=z1 * z2 * (v1 - v2), d=z2 - z1, k=v2 * z2 - v1 * z1)


def depth_from_constants(v: Float, constants: StripeConstants) -> Float:
    """Depth z of points of a stripe seen at v, eq. 18; NaN at its pole and behind it."""
    below = v * constants.d - constants.k
    with np.errstate(divide="ignore", invalid="ignore"):
        z = constants.n / below
    return np.asarray(np.where(np.isfinite(z) & (z > 0), z, np.nan))


def height(z: Float, h_m: float, alpha: float = 0.0) -> Float:
    """Height of a point at depth z, eq. 19: h = h_m - z cos(alpha); alpha = 0 in rectified coordinates."""
    return np.asarray(h_m - z * np.cos(alpha))


def ortho_u(u: Float, h: Float, camera_height: float, u0: float) -> Float:
    """Position across in the ortho image, eq. 20; the printed u0 of its first term must be u0', as in eq. 21.

    Args:
        u: position across in the perspective range image.
        h: height of the surface there.
        camera_height: H, of the optical centre above the floor.
        u0: u0', of the nadir.
    """
    return np.asarray((u - u0) * (camera_height - h) / camera_height + u0)


def ortho_v(v: Float, h: Float, camera_height: float, v0: float) -> Float:
    """Position along in the ortho image, eq. 21; v0 is v0', of the nadir."""
    return np.asarray((v - v0) * (camera_height - h) / camera_height + v0)
