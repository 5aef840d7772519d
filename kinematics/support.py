"""The support plane: the plane through the soles that carry the body, in `base_link`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinematics.arrays import Float, read_only
from kinematics.exceptions import StanceError

# Soles that scatter less than this across their line [m, rms] span no plane: 1 mm would tilt it 6 degrees.
LEAST_WIDTH = 0.010


@dataclass(frozen=True, slots=True, eq=False)
class SupportPlane:
    """The least-squares plane z = a x + b y + c through n soles.

    Attributes:
        coefficients: (3,) a, b [-] and c [m].
        normal: (3,) unit normal, pointing up, in `base_link`.
        residual: rms distance of the soles from the plane [m]; zero for three soles.
        gain: (3, n) d(a, b, c) / d(height of each sole over the plane, measured along z).
    """

    coefficients: Float
    normal: Float
    residual: float
    gain: Float


def fit_support_plane(soles_in_base: Float) -> SupportPlane:
    """Fit the support plane.

    Args:
        soles_in_base: (n, 3) sole centres [m], n >= 3.

    Raises:
        StanceError: fewer than three soles, or soles on one line.
    """
    count = len(soles_in_base)
    if count < 3:
        raise StanceError(f"support_feet: {count} given; a support plane needs three feet or more")
    offsets = soles_in_base[:, :2] - soles_in_base[:, :2].mean(axis=0)
    width = np.sqrt(np.linalg.eigvalsh(offsets.T @ offsets)[0] / count)
    if width < LEAST_WIDTH:
        raise StanceError(
            f"support_feet: the {count} soles lie on one line (within {1e3 * width:.1f} mm); "
            "a support plane needs feet on both sides"
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
