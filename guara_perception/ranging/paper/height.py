"""Heights of the paper, eqs. 14 to 19: from where a stripe is seen to how high it lies.

In rectified floor coordinates (after eqs. 9 and 10) these equations are exact: there f and the pitch drop out, v is
the position on the floor measured across the stripe and z = H - h, with H the height of the optical centre.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from guara_perception.arrays import Float
from guara_perception.exceptions import InvalidInput

Number = float | Float


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
    """Place y of the laser's line at depth z through two of its points, eq. 15."""
    return y1 + (y2 - y1) * (z - z1) / (z2 - z1)


def line_residual(v: float, z: float, v1: float, z1: float, v2: float, z2: float) -> float:
    """How far a point (v, z) is from the laser's line in image terms, eq. 16 cross-multiplied; 0 on the line."""
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
