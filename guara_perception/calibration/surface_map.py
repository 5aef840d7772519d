"""Calibration as in the paper: floor homography from fiducials (eqs. 9 to 13), n, d, k per stripe (eqs. 14 to 19)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from guara_perception.arrays import Float
from guara_perception.exceptions import InvalidInput
from kinematics.arrays import FrozenArrays


@dataclass(frozen=True, slots=True)
class SurfaceMap(FrozenArrays):
    """Homography from undistorted pixels to the floor (eqs. 9 to 13), fitted to four or more marks.

    Attributes:
        homography: (3, 3) matrix that maps (u, v, 1) to (x, y, 1) in base_footprint [m]; its last entry is 1.
        condition: condition number of the normalised linear system.
        residual: (n, 2) floor points found minus given [m]; zero for four marks.
    """

    homography: Float
    condition: float
    residual: Float

    @property
    def rms(self) -> float:
        """Root mean square distance of the marks from their floor points [m]."""
        return float(np.sqrt((self.residual**2).sum(axis=1).mean()))


def surface_map(pixels: npt.ArrayLike, points: npt.ArrayLike) -> SurfaceMap:
    """Compute the homography by the normalised direct linear transform.

    The paper sets the last element, i, to 1 and solves eight equations for four marks. Here pixels and points are
    centred and scaled, and the solution is the singular vector with the smallest singular value, which allows any
    number of marks.

    Args:
        pixels: (n, 2) undistorted pixels, n >= 4.
        points: (n, 2) floor points [m].

    Raises:
        InvalidInput: the arrays differ in shape or are not two-dimensional, there are fewer than four marks, or the
            marks do not determine a homography (for example, three of four are collinear).
    """
    u, x = np.asarray(pixels, dtype=np.float64), np.asarray(points, dtype=np.float64)
    if u.shape != x.shape or u.ndim != 2 or len(u) < 4:
        raise InvalidInput(
            f"a surface map needs pixels and points, (n, 2), of four or more marks; pixels {u.shape} and points "
            f"{x.shape} were given"
        )
    from_pixels, from_points = _normaliser(u), _normaliser(x)
    a = apply_homography(from_pixels, u)
    b = apply_homography(from_points, x)
    rows = np.zeros((2 * len(a), 9))
    rows[0::2, 0:2], rows[0::2, 2] = a, 1
    rows[0::2, 6:8], rows[0::2, 8] = -a * b[:, :1], -b[:, 0]
    rows[1::2, 3:5], rows[1::2, 5] = a, 1
    rows[1::2, 6:8], rows[1::2, 8] = -a * b[:, 1:], -b[:, 1]
    singular, vectors = np.linalg.svd(rows)[1:]
    condition = float(singular[0] / max(singular[7], 1e-15))
    if condition > 1e6:
        raise InvalidInput(
            f"the marks do not determine a surface map (condition number {condition:.1g}): they may be collinear"
        )
    homography = np.linalg.inv(from_points) @ vectors[-1].reshape(3, 3) @ from_pixels
    homography = homography / homography[2, 2]
    return SurfaceMap(homography, condition, apply_homography(homography, u) - x)


def apply_homography(homography: Float, points: npt.ArrayLike) -> Float:
    """Map points (n, 2) by a homography (3, 3) (eqs. 9 and 10)."""
    homogeneous = np.column_stack((np.asarray(points, dtype=np.float64), np.ones(len(np.asarray(points)))))
    mapped = homogeneous @ homography.T
    return np.asarray(mapped[:, :2] / mapped[:, 2:])


def stripe_constants(
    index: int, height_of_camera: float, x: Sequence[float], heights: Sequence[float]
) -> dict[str, float]:
    """Fit the paper's constants n, d, k of one stripe to its positions on plates of known height.

    Let H be the height of the optical centre, h that of a plate, and v the rectified x [m] of the stripe at the y of
    the nadir. Then z = H - h = n / (v d - k) is exact (eqs. 17 to 19). Two heights determine n and k; more heights
    leave a residual. The scale d is the smallest minus the largest z, as in eq. 17, so that the equation
    z v d - z k = n is linear in k and n.

    Args:
        index: index of the stripe.
        height_of_camera: H [m].
        x: rectified x of the stripe on each plate, which is the x of the floor point on the same ray [m].
        heights: heights of the plates [m].

    Returns:
        Dictionary with `index`, `n`, `d`, `k` and `residual`, the rms error of the heights of the plates [m] (zero for
        two heights).

    Raises:
        InvalidInput: there are fewer than two different heights, or the stripe has the same position at all of them
            (eq. 17 is singular).
    """
    v, z = np.asarray(x, dtype=np.float64), height_of_camera - np.asarray(heights, dtype=np.float64)
    if len(v) < 2 or np.ptp(z) < 1e-6 or np.ptp(v) < 1e-6:
        raise InvalidInput(
            f"stripe index {index}: two or more heights with different positions of the stripe are needed (eq. 17)"
        )
    d = float(z.min() - z.max())
    k, n = np.linalg.lstsq(np.column_stack((z, np.ones(len(z)))), z * v * d, rcond=None)[0].tolist()
    error = n / (v * d - k) - z
    return {"index": index, "n": n, "d": d, "k": k, "residual": float(np.sqrt(np.mean(error**2)))}


def _normaliser(points: Float) -> Float:
    """Homogeneous matrix (3, 3) that maps points to mean zero and mean distance sqrt(2) from the mean."""
    centre = points.mean(axis=0)
    scale = np.sqrt(2) / max(float(np.linalg.norm(points - centre, axis=1).mean()), 1e-12)
    return np.array([[scale, 0, -scale * centre[0]], [0, scale, -scale * centre[1]], [0, 0, 1.0]])
