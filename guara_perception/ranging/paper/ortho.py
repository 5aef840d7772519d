"""Orthorectification of the paper, eqs. 20 and 21: every height moved to its true position.

A homography does not move the optical centre, so (u0', v0') is the nadir, the spot below the camera, which usually
lies outside the picture; only about the nadir the equations are exact.
"""

from __future__ import annotations

import numpy as np

from guara_perception.arrays import Float


def ortho_u(u: Float, h: Float, camera_height: float, u0: float) -> Float:
    """Place across in the ortho image, eq. 20; the printed u0 of its first term must be u0', as in eq. 21.

    Args:
        u: position across in the perspective range image.
        h: height of the surface there.
        camera_height: H, of the optical centre above the floor.
        u0: u0', of the nadir.
    """
    return np.asarray((u - u0) * (camera_height - h) / camera_height + u0)


def ortho_v(v: Float, h: Float, camera_height: float, v0: float) -> Float:
    """Place along in the ortho image, eq. 21; v0 is v0', of the nadir."""
    return np.asarray((v - v0) * (camera_height - h) / camera_height + v0)
