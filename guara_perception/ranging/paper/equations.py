"""Equations of the paper's chain by number: lens (8), floor (9, 10), heights (16 to 19), ortho image (20, 21).

Eqs. 1 to 7 and 11 to 13 belong to the calibration (`CameraModel`, `surface_map`).

Eqs. 14 to 19 are exact in rectified floor coordinates (after eqs. 9 and 10): there f and the pitch drop out, v is the
position on the floor measured across the stripe, and z = H - h, where H is the height of the optical centre.

A homography does not move the optical centre, so (u0', v0') of eqs. 20 and 21 is the nadir, the point below the camera,
which usually lies outside the image. The equations are exact only about the nadir.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from guara_perception.arrays import Float
from guara_perception.exceptions import InvalidInput

# Fixed-point iterations of eq. 8. They leave an error below 0.001 px at a radius of 0.7 focal lengths for k = -0.3.
UNDISTORT_ITERATIONS = 12

Number = float | Float


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
