"""A pose of odometry, before anything is fused by it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from guara_perception.arrays import Float
from guara_perception.exceptions import InvalidInput

# Without gravity a scan is levelled by its support plane, which tilts by 0.11 rad with two feet on a box of 40 mm.
LARGEST_TILT = 0.2
# Two computations of one vertical differ by rounding: a tilt that moves nothing by more than a nanometre is zero.
LEAST_TURN = 1e-9


def checked_pose(transform: npt.ArrayLike, covariance: npt.ArrayLike) -> tuple[Float, Float]:
    """Copies of transform_footprint_to_odom (4, 4) and its covariance (6, 6), fit to be used.

    Raises:
        InvalidInput: a transform that is not rigid or tilts by more than 0.2 rad; a covariance that is not (6, 6) with
            a positive diagonal.
    """
    matrix = np.array(transform, dtype=np.float64)
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all() or np.abs(matrix[3] - [0, 0, 0, 1]).max() > 1e-9:
        raise InvalidInput(f"transform_footprint_to_odom has shape {matrix.shape}, it must be a rigid (4, 4)")
    rotation = matrix[:3, :3]
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-6 or rotation[2, 2] < np.cos(LARGEST_TILT):
        raise InvalidInput(
            "transform_footprint_to_odom is no rotation, or tilts by more than "
            f"{LARGEST_TILT} rad: both frames must be level"
        )
    rotation[np.abs(rotation) < LEAST_TURN] = 0.0
    return matrix, checked_covariance(covariance)


def checked_covariance(covariance: npt.ArrayLike) -> Float:
    """A copy of a covariance (6, 6), fit to be used.

    Raises:
        InvalidInput: it is not (6, 6) with a positive diagonal.
    """
    checked = np.array(covariance, dtype=np.float64)
    if checked.shape != (6, 6) or not np.isfinite(checked).all() or (np.diag(checked) < 0).any():
        raise InvalidInput(f"covariance has shape {checked.shape}, it must be (6, 6) with a positive diagonal")
    return checked
