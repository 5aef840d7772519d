"""Geometry of `base_footprint`: support plane, transform from soles and vertical, propagation of noise.

With u the unit vertical in `base_link` and p_i the supporting soles, the rows of the rotation from base to
footprint are

    x = (e_x - u_x u) / s,   s = sqrt(1 - u_x^2)      the body's x axis projected onto the horizontal
    y = u cross x
    z = u

and the translation is (0, 0, h) with h = -u . mean(p_i). The footprint is vertically below the body's origin, with
z = 0 at the mean of the soles.

A small change du of the vertical changes the rotation by B du about the footprint's axes, where B has the rows y, -x
and (u_x / s) y. The last row keeps the heading aligned with the body's x axis when the body tilts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinematics.arrays import Float, read_only
from kinematics.exceptions import StanceError

# Frames that are not links of the URDF. Their axes follow REP-103 (x forward, y left, z up).
# Origin vertically below the body's origin, at the mean height of the supporting soles.
BASE_FOOTPRINT = "base_footprint"
# Equal to `base_footprint` of the first pause; leg odometry tracks the robot in it.
ODOM = "odom"
# Smallest rms distance of the soles from their best-fitting line at which they define a plane [m]. At this distance, an
# error of 1 mm tilts the plane by 6 degrees.
LEAST_WIDTH = 0.010


def transform_base_to_footprint(soles_in_base: Float, up: Float) -> Float:
    """Transform (4, 4) from base to footprint for supporting soles (n, 3) [m] and unit vertical (3,) in `base_link`."""
    x = np.array([1.0, 0.0, 0.0]) - up[0] * up
    x /= np.linalg.norm(x)
    transform = np.eye(4)
    transform[:3, :3] = x, np.cross(up, x), up
    transform[2, 3] = -up @ soles_in_base.mean(axis=0)
    return transform


def footprint_jacobians(soles_in_base: Float, transform: Float, up_by_soles: Float) -> tuple[Float, Float]:
    """Derivatives of the transform from base to footprint with respect to soles and vertical.

    Rows are in REP-103 order (x y z, rotations about fixed axes).

    Args:
        soles_in_base: (n, 3) supporting soles [m].
        transform: (4, 4) transform from base to footprint.
        up_by_soles: (3, 3 n) d(vertical) / d(soles); zero if the vertical does not depend on the soles.

    Returns:
        by_soles (6, 3 n) and by_vertical (6, 3); by_soles includes the effect of the soles on the vertical.
    """
    count = len(soles_in_base)
    x, y, up = transform[:3, :3]
    by_vertical = np.zeros((6, 3))
    by_vertical[2] = -soles_in_base.mean(axis=0)
    # Matrix B of the module's docstring.
    by_vertical[3:] = y, -x, up[0] / np.sqrt(1.0 - up[0] ** 2) * y
    by_soles = by_vertical @ up_by_soles
    by_soles[2] -= np.tile(up, count) / count
    return by_soles, by_vertical


def skew(vector: Float) -> Float:
    """Cross-product matrix (3, 3) of a vector a, whose product with a vector b is a x b."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


@dataclass(frozen=True, slots=True, eq=False)
class SupportPlane:
    """Least-squares plane z = a x + b y + c fitted to n soles.

    Attributes:
        coefficients: (3,) a, b [-] and c [m].
        normal: (3,) unit normal, pointing up, in `base_link`.
        residual: rms distance of the soles from the plane [m]; zero for three soles.
        gain: (3, n) d(a, b, c) / d(z of each sole).
    """

    coefficients: Float
    normal: Float
    residual: float
    gain: Float


def fit_support_plane(soles_in_base: Float) -> SupportPlane:
    """Fit the support plane to sole centres by least squares.

    Args:
        soles_in_base: (n, 3) sole centres [m], n >= 3.

    Raises:
        StanceError: there are fewer than three soles, or their rms distance in x and y from the line that fits them
            best is less than `LEAST_WIDTH`.
    """
    count = len(soles_in_base)
    if count < 3:
        raise StanceError(f"support_feet: {count} given; a support plane needs three feet or more")
    offsets = soles_in_base[:, :2] - soles_in_base[:, :2].mean(axis=0)
    width = np.sqrt(np.linalg.eigvalsh(offsets.T @ offsets)[0] / count)
    if width < LEAST_WIDTH:
        raise StanceError(
            f"support_feet: the {count} soles lie on one line (within {1e3 * width:.1f} mm); "
            "a support plane needs a foot off this line"
        )
    terms = np.ones((count, 3))
    terms[:, :2] = soles_in_base[:, :2]
    gain = np.linalg.inv(terms.T @ terms) @ terms.T
    a, b, c = coefficients = gain @ soles_in_base[:, 2]
    steepness = np.sqrt(1.0 + a * a + b * b)
    distances = (soles_in_base @ np.array([-a, -b, 1.0]) - c) / steepness
    residual = float(np.sqrt(np.mean(distances**2))) if count > 3 else 0.0
    return SupportPlane(
        read_only(coefficients), read_only(np.array([-a, -b, 1.0]) / steepness), residual, read_only(gain)
    )
