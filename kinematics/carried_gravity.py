"""Propagation of the gravity direction from pause to pause without an IMU.

Three or more soles that stayed in place give the rotation of the body since the last pause. This rotation transforms
the vertical of that pause to the new one. The error of the carried vertical grows from pause to pause and is bounded by
the support plane: if the carried vertical is accurate enough to distinguish level ground from a slope, and the plane's
normal agrees with it within noise, the plane is assumed to be level. Otherwise the plane is ignored, because on a long
slope all planes tilt in the same direction, and each would pull the vertical a little further towards its normal.
"""

from __future__ import annotations

import numpy as np

from kinematics.arrays import Float
from kinematics.footprint import fit_support_plane
from kinematics.stance_pose import GravityEstimate, StanceNoise
from kinematics.transforms import unit_vector

# Largest rms deviation of a level support plane from the carried vertical, over both axes [sigmas]; noise exceeds it
# for 0.2 % of level planes.
FLAT_SIGMAS = 2.5

# The carried vertical distinguishes level ground from a slope only if its sigma is below this fraction of
# `terrain_slope_sigma`.
SURE_SHARE = 0.5


def carry_gravity(
    before: GravityEstimate,
    soles_now: Float,
    soles_before: Float,
    support_now: Float,
    covariances_now: Float,
    noise: StanceNoise,
) -> GravityEstimate:
    """Compute the direction of gravity in `base_link` at this pause from that at the previous pause.

    Args:
        before: direction of gravity at the previous pause, in `base_link` of that pause.
        soles_now: (n, 3) soles that stayed, in `base_link` of this pause [m], n >= 3.
        soles_before: (n, 3) the same soles in `base_link` of the previous pause [m].
        support_now: (m, 3) all supporting soles in `base_link` of this pause [m], m >= 3.
        covariances_now: (m, 3, 3) covariances of `support_now` [m^2].
        noise: noise of a stance; only `terrain_slope_sigma` is used.

    Raises:
        StanceError: the supporting soles are on one line.
    """
    rotation = turn_between(soles_now, soles_before)
    up = -rotation.T @ unit_vector(before.gravity_in_base)
    plane = fit_support_plane(support_now)
    # Variance of the support plane's tilt, mean of both axes, from the heights of its soles [rad^2].
    tilt_variance = float(np.mean(plane.gain[:2] ** 2 @ covariances_now[:, 2, 2]))
    variance = before.sigma**2 + 2.0 * tilt_variance
    missed = plane.normal - up
    missed = missed - up * (up @ missed)
    agrees = missed @ missed < FLAT_SIGMAS**2 * 2.0 * (variance + tilt_variance)
    is_level = agrees and variance < (SURE_SHARE * noise.terrain_slope_sigma) ** 2
    gain = variance / (variance + tilt_variance) if is_level else 0.0
    up = up + gain * missed
    up /= np.linalg.norm(up)
    return GravityEstimate((-up[0], -up[1], -up[2]), float(np.sqrt(variance * (1.0 - gain))))


def turn_between(points_now: Float, points_before: Float) -> Float:
    """Rotation (3, 3) from the present frame to the previous one that best aligns points (n, 3), n >= 3 (Kabsch)."""
    covariance = (points_now - points_now.mean(axis=0)).T @ (points_before - points_before.mean(axis=0))
    left, _, right = np.linalg.svd(covariance)
    sign = np.sign(np.linalg.det(right.T @ left.T))
    return np.asarray(right.T @ np.diag([1.0, 1.0, sign]) @ left.T)
