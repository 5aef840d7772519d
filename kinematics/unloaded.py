"""Detection of one unloaded foot among four: a foot that hangs above the plane of the others.

The deviation of four soles from a common plane is a single number. It can show that a foot hangs, but not which of the
two feet at the ends of the raised diagonal. These criteria decide, in this order:

1. Level: if the vertical is known, the three remaining feet must be level with each other. If this fails for
   both candidates, the ground is uneven, there is no evidence of a hanging foot, and all four feet are kept.
2. Balance: the centre of mass must be above the triangle of the loaded feet, which is beyond the other diagonal as seen
   from the hanging foot. A foot carries load if the centre of mass is on the foot's side of that diagonal by more than
   the uncertainty of the centre of mass.
3. Tilt: the body is commanded to be level, so of the two triangles, the one relative to which the body is tilted less
   carries the load.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinematics.arrays import Array, Float


@dataclass(frozen=True, slots=True, eq=False)
class FourFeet:
    """Soles of four feet, with the centre of mass and the vertical.

    Attributes:
        soles: (4, 3) sole centres in `base_link` [m].
        covariances: (4, 3, 3) covariances of `soles` [m^2].
        centre_of_mass: (3,) position in `base_link` [m].
        centre_of_mass_sigma: standard deviation of the horizontal position of the centre of mass [m].
        up: (3,) unit vertical in `base_link`; None if unknown.
        up_sigma: standard deviation of the vertical per axis [rad].
    """

    soles: Float
    covariances: Float
    centre_of_mass: Float
    centre_of_mass_sigma: float
    up: Float | None
    up_sigma: float


def find_unloaded_foot(feet: FourFeet, sigmas: float) -> int | None:
    """Find the row of the foot that hangs; None if there is no such foot.

    Args:
        feet: the four feet.
        sigmas: minimum height of a hanging foot above the plane of the other three, and largest height difference
            between level feet, in standard deviations.
    """
    corners = feet.soles[OTHERS]
    corners[..., 2] = 1.0
    # Three soles on a line span no plane, above which the fourth could hang.
    spanning = np.flatnonzero(np.abs(np.linalg.det(corners)) > LEAST_AREA)
    candidates = spanning[_gaps_in_sigmas(feet, spanning) > sigmas].tolist()
    if feet.up is not None:
        candidates = [row for row in candidates if _others_level(feet, row, sigmas)]
    if len(candidates) < 2:
        return candidates[0] if candidates else None
    balanced = [row for row in candidates if _balance_away_from(feet, row) > -feet.centre_of_mass_sigma]
    if len(balanced) == 1:
        return balanced[0]
    return max(candidates, key=lambda row: float(_normal(feet.soles[OTHERS[row]])[2]))


# Rows of the other three feet, for each foot.
OTHERS = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])
# Twice the smallest area of a triangle of soles that defines a plane [m^2]: two soles 0.3 m apart, and a third 0.03 mm
# from the line between them.
LEAST_AREA = 1e-5


def _normal(threes: Float) -> Float:
    """Unit normals (..., 3), pointing up, of planes through three soles (..., 3, 3)."""
    first = threes[..., 0, :]
    normal = np.cross(threes[..., 1, :] - first, threes[..., 2, :] - first)
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    return np.asarray(normal / np.where(normal[..., 2:] > 0.0, length, -length))


def _gaps_in_sigmas(feet: FourFeet, rows: Array) -> Float:
    """Height (r,) of the soles of these rows above the plane of the other three, in standard deviations."""
    others = feet.soles[OTHERS[rows]]
    normals = _normal(others)
    gaps = np.vecdot(normals, feet.soles[rows] - others[:, 0])
    # The point of the plane below a sole is the sum of the three other soles, weighted by barycentric coordinates.
    under, corners = (feet.soles[rows] - gaps[:, None] * normals), np.swapaxes(others, 1, 2).copy()
    under[:, 2], corners[:, 2] = 1.0, 1.0
    weights = np.linalg.solve(corners, under[..., None])[..., 0]
    along_normals = np.einsum("ri,fij,rj->rf", normals, feet.covariances, normals)
    of_others = np.take_along_axis(along_normals, OTHERS[rows], axis=1)
    variances = along_normals[np.arange(len(rows)), rows] + np.vecdot(weights**2, of_others)
    return np.asarray(gaps / np.sqrt(variances))


def _others_level(feet: FourFeet, row: int, sigmas: float) -> bool:
    """Test that the other three soles are at the same height, within the errors of soles and vertical."""
    up = np.asarray(feet.up)
    others, covariances = feet.soles[OTHERS[row]], feet.covariances[OTHERS[row]]
    heights = others @ up
    for i, j in ((0, 1), (0, 2), (1, 2)):
        variance = up @ (covariances[i] + covariances[j]) @ up
        variance += (feet.up_sigma * np.linalg.norm(others[i] - others[j])) ** 2
        if abs(heights[i] - heights[j]) > sigmas * np.sqrt(variance):
            return False
    return True


def _balance_away_from(feet: FourFeet, row: int) -> float:
    """Distance [m] of the centre of mass beyond the diagonal between a foot's neighbours, as seen from that foot.

    If the vertical is unknown, the normal of the plane of the other feet is used, as if this foot hung.
    """
    others, up = feet.soles[OTHERS[row]], feet.up
    if up is None:
        up = _normal(others)
    # The opposite foot is the one for which the line to it separates the other two.
    for opposite in range(3):
        i, j = (other for other in range(3) if other != opposite)
        across = np.cross(up, others[opposite] - feet.soles[row])
        if (across @ (others[i] - feet.soles[row])) * (across @ (others[j] - feet.soles[row])) < 0.0:
            side = np.cross(up, others[j] - others[i])
            side *= np.sign(side @ (others[opposite] - others[i])) / np.linalg.norm(side)
            return float(side @ (feet.centre_of_mass - others[i]))
    return 0.0
