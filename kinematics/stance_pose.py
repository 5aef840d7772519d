"""Pose of the body above the ground at a pause, with its covariance.

The covariance of the transform from base to footprint is

    s^2 B (I - u u') B' + sum A_i C_i A_i'

where u is the vertical in `base_link` (variance s^2 per axis perpendicular to u) and C_i the covariance of sole i. B
and A_i are the derivatives of the transform with respect to the vertical and to sole i, including the effect of the
sole on the vertical (`footprint_jacobians`). If the vertical is the normal of the support plane, s is zero.

Points measured in `base_link` do not depend on this pose. The pose is needed to align the points with gravity and to
relate the scans of different pauses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from kinematics.arrays import Float, read_only
from kinematics.exceptions import ArgumentError, StanceError
from kinematics.footprint import (
    SupportPlane,
    fit_support_plane,
    footprint_jacobians,
    transform_base_to_footprint,
)
from kinematics.stance import checked_gravity
from kinematics.toml_table import Table
from kinematics.transforms import checked_transform, inverse, transform_points, unit_vector
from kinematics.tree import RobotState
from kinematics.unloaded import FourFeet, find_unloaded_foot

# Sources of the vertical. The default is the first available one of imu, odometry and support_plane.
ATTITUDE_SOURCES = ("imu", "odometry", "support_plane", "level")

# Minimum z of the vertical in `base_link`: a body tilted by more than 60 degrees has fallen.
LEAST_UP_Z = 0.5

# Default white noise of a joint [rad]: 0.05 degrees, plus the quantisation of a 12-bit encoder. If the true noise
# is several times larger, scans are withdrawn; if it is smaller, motions of 1.5 mm are still detected.
ENCODER_NOISE = 0.001


@dataclass(frozen=True, slots=True)
class StanceNoise:
    """Standard deviations of the errors of a stance, and the limit for unloaded feet (robot.toml, table [stance]).

    Attributes:
        encoder_sigma: bias of one joint angle [rad], constant over a pause; for a prismatic joint, this and
            `encoder_noise` are multiplied by 0.2 m (`KinematicTree.joint_scales`).
        encoder_noise: white noise of one joint reading [rad], including quantisation (step / sqrt(12)). If robot.toml
            does not give it, it is the smaller of `ENCODER_NOISE` and `encoder_sigma`.
        contact_sigma: position of the sole centre relative to the ground, per axis [m].
        sole_pitch_sigma: pitch of a flat sole while it carries the body [rad].
        imu_sigma: direction of gravity from an IMU at rest, per axis [rad].
        level_sigma: tilt of a body that is assumed level, per axis [rad].
        terrain_slope_sigma: tilt of the support plane from the horizontal, per axis [rad].
        centre_of_mass_sigma: horizontal position of the centre of mass [m].
        unloaded_sigmas: a foot that is more than this many sigmas above the plane of the others may be unloaded [-].
    """

    encoder_sigma: float
    contact_sigma: float
    sole_pitch_sigma: float
    imu_sigma: float
    level_sigma: float
    terrain_slope_sigma: float
    centre_of_mass_sigma: float
    unloaded_sigmas: float
    encoder_noise: float = ENCODER_NOISE

    @classmethod
    def from_table(cls, table: Table) -> StanceNoise:
        """Read the table [stance]; every value must be positive."""
        noise = table.record(cls)
        is_given = "encoder_noise" in table.values
        return noise if is_given else replace(noise, encoder_noise=min(ENCODER_NOISE, noise.encoder_sigma))


@dataclass(frozen=True, slots=True)
class GravityEstimate:
    """Direction of gravity in `base_link`, pointing down, any length, and its sigma per axis [rad]."""

    gravity_in_base: tuple[float, float, float]
    sigma: float


@dataclass(frozen=True, slots=True, eq=False)
class StancePose:
    """Pose of the body at one stance pause; all arrays are read-only.

    Attributes:
        transform_base_to_footprint: (4, 4) pose of the body.
        covariance: (6, 6) covariance of this transform, REP-103 order (x y z [m], rotations about the footprint's fixed
            axes [rad]). Rows and columns of x and y are zero by definition; those of the rotation about z are not if
            the body is pitched, because the heading follows the body's x axis. With attitude source `support_plane`,
            the covariance is relative to that plane, not to gravity.
        attitude_source: "imu", "odometry", "support_plane" or "level".
        attitude_sigma: standard deviation of the vertical relative to gravity, per axis [rad]; with `support_plane` it
            includes the slope of the ground (robot.toml, [stance] terrain_slope_sigma).
        support_feet_used: feet used to compute the pose.
        unloaded_feet: feet that were named as supporting but found unloaded and therefore not used.
        support_residual: rms distance of the used soles from their plane [m]; zero for three feet, NaN for fewer.
        soles_in_footprint: (n, 3) centres of the used soles [m].
        transform_camera_to_footprint: (4, 4), from the calibrated pose of the camera on the body if given, else from
            the URDF.
        state: state of the robot.
    """

    transform_base_to_footprint: Float
    covariance: Float
    attitude_source: str
    attitude_sigma: float
    support_feet_used: tuple[str, ...]
    unloaded_feet: tuple[str, ...]
    support_residual: float
    soles_in_footprint: Float
    transform_camera_to_footprint: Float
    state: RobotState

    @property
    def transform_footprint_to_base(self) -> Float:
        """Inverse of `transform_base_to_footprint`, (4, 4)."""
        return read_only(inverse(self.transform_base_to_footprint))

    @property
    def up_in_base(self) -> Float:
        """Unit vertical in `base_link`, (3,)."""
        return read_only(self.transform_base_to_footprint[2, :3])

    @property
    def gravity(self) -> GravityEstimate:
        """Direction of gravity in this pose, opposite to `up_in_base`."""
        down = (-self.up_in_base).tolist()
        return GravityEstimate((down[0], down[1], down[2]), self.attitude_sigma)

    @property
    def height(self) -> float:
        """Height of the body's origin above the mean of the used soles [m]."""
        return float(self.transform_base_to_footprint[2, 3])

    @property
    def roll(self) -> float:
        """Roll of the body [rad], positive with its left side up."""
        return float(np.arctan2(self.up_in_base[1], self.up_in_base[2]))

    @property
    def pitch(self) -> float:
        """Pitch of the body [rad], positive nose down."""
        return float(np.arcsin(-self.up_in_base[0]))


def stance_pose(
    state: RobotState,
    support_feet: Sequence[str],
    gravity_in_base: Sequence[float] | None = None,
    *,
    noise: StanceNoise,
    attitude: str | None = None,
    odometry: GravityEstimate | None = None,
    transform_camera_to_base: npt.ArrayLike | None = None,
    find_unloaded: bool = True,
) -> StancePose:
    """Compute the pose of a stance.

    Args:
        state: the robot's state.
        support_feet: legs whose soles carry the body.
        gravity_in_base: direction of gravity from an IMU, pointing down; None without an IMU.
        noise: standard deviations.
        attitude: one of `ATTITUDE_SOURCES`; None = the first available of `imu`, `odometry`, `support_plane`.
        odometry: gravity propagated from earlier pauses.
        transform_camera_to_base: (4, 4) calibrated pose of the camera; None = the pose in the URDF.
        find_unloaded: True = if four feet are given, exclude a foot that is found unloaded.

    Raises:
        UnknownName: a leg that the robot does not have.
        StanceError: too few feet for the attitude source, three or more feet on a line, gravity or odometry requested
            but not given, or a body tilted by more than 60 degrees.
        ArgumentError: an unknown attitude source, or a matrix that is not a transform.
    """
    legs = list(support_feet)
    source, up, sigma = _vertical(attitude, gravity_in_base, odometry, noise)
    least = 1 if source in ("imu", "odometry") else 3
    if len(legs) < least:
        raise StanceError(
            f"support_feet: {len(legs)} given ({', '.join(legs) or 'none'}); attitude from {source!r} needs "
            f"{least} or more" + ("; otherwise use attitude 'imu' with gravity_in_base" if least == 3 else "")
        )
    soles = state.soles_in_base(legs)
    covariances = sole_covariances(state, legs, noise)
    unloaded: list[str] = []
    if find_unloaded and len(legs) == 4:
        centre = state.centre_of_mass_in_base
        feet = FourFeet(soles, covariances, centre, noise.centre_of_mass_sigma, up, sigma)
        row = find_unloaded_foot(feet, noise.unloaded_sigmas)
        if row is not None:
            unloaded.append(legs.pop(row))
            soles, covariances = np.delete(soles, row, axis=0), np.delete(covariances, row, axis=0)
    plane = fit_support_plane(soles) if len(legs) >= 3 else None
    up_by_soles = np.zeros((3, 3 * len(legs)))
    if up is None:
        up, up_by_soles = _plane_vertical(plane, len(legs))  # type: ignore[arg-type]
    if up[2] < LEAST_UP_Z:
        raise StanceError(
            f"the body is tilted by {np.degrees(np.arccos(up[2])):.0f} degrees (attitude from {source!r}); "
            "the limit is 60 degrees"
        )
    transform = transform_base_to_footprint(soles, up)
    by_soles, by_vertical = footprint_jacobians(soles, transform, up_by_soles)
    covariance = sigma**2 * by_vertical @ (np.eye(3) - np.outer(up, up)) @ by_vertical.T
    for row, sole_covariance in enumerate(covariances):
        block = by_soles[:, 3 * row : 3 * row + 3]
        covariance += block @ sole_covariance @ block.T
    if source == "support_plane":
        sigma = float(np.sqrt(np.mean(np.diag(covariance)[3:5]) + noise.terrain_slope_sigma**2))
    if transform_camera_to_base is None:
        camera = state.transform_to_base(state.tree.config.camera_frame)
    else:
        camera = checked_transform(transform_camera_to_base, "transform_camera_to_base")
    return StancePose(
        transform_base_to_footprint=read_only(transform),
        covariance=read_only(covariance),
        attitude_source=source,
        attitude_sigma=sigma,
        support_feet_used=tuple(legs),
        unloaded_feet=tuple(unloaded),
        support_residual=plane.residual if plane is not None else float("nan"),
        soles_in_footprint=read_only(transform_points(transform, soles)),
        transform_camera_to_footprint=read_only(transform @ camera),
        state=state,
    )


def sole_covariances(state: RobotState, legs: Sequence[str], noise: StanceNoise) -> Float:
    """Covariance of each sole centre in `base_link`, (n, 3, 3) [m^2], from encoder bias and contact noise."""
    contact = noise.contact_sigma**2 * np.eye(3)
    jacobians = [state.noise_jacobian(state.tree.leg(leg).sole)[:3] for leg in legs]
    return np.reshape([noise.encoder_sigma**2 * j @ j.T + contact for j in jacobians], (-1, 3, 3))


def support_soles(pose: StancePose, noise: StanceNoise) -> dict[str, Float]:
    """Used soles by leg, (4, 3) in `base_footprint`: centre [m], then the rows of its covariance [m^2]."""
    legs, transform = pose.support_feet_used, np.asarray(pose.transform_base_to_footprint)
    soles = transform_points(transform, pose.state.soles_in_base(legs))
    rotation = transform[:3, :3]
    return {
        leg: np.vstack((sole, rotation @ covariance @ rotation.T))
        for leg, sole, covariance in zip(legs, soles, sole_covariances(pose.state, legs, noise), strict=True)
    }


def _vertical(
    attitude: str | None,
    gravity_in_base: Sequence[float] | None,
    odometry: GravityEstimate | None,
    noise: StanceNoise,
) -> tuple[str, Float | None, float]:
    """Attitude source, unit vertical (None = the support plane's normal), and sigma of the vertical [rad]."""
    if attitude is None:
        attitude = "imu" if gravity_in_base is not None else "odometry" if odometry is not None else "support_plane"
    if attitude not in ATTITUDE_SOURCES:
        raise ArgumentError(f"attitude is {attitude!r}; allowed: None, {', '.join(map(repr, ATTITUDE_SOURCES))}")
    if attitude == "imu":
        if gravity_in_base is None:
            raise StanceError("attitude 'imu' was requested, but the stance has no gravity_in_base")
        return attitude, -unit_vector(checked_gravity(gravity_in_base)), noise.imu_sigma
    if attitude == "odometry":
        if odometry is None:
            raise StanceError("attitude 'odometry' was requested, but no odometry was given")
        return attitude, -unit_vector(checked_gravity(odometry.gravity_in_base)), odometry.sigma
    if attitude == "level":
        return attitude, np.array([0.0, 0.0, 1.0]), noise.level_sigma
    return attitude, None, 0.0


def _plane_vertical(plane: SupportPlane, count: int) -> tuple[Float, Float]:
    """Normal of the support plane, and derivative (3, 3 n) of the normal with respect to the soles."""
    a, b, _ = plane.coefficients
    upright = np.array([-a, -b, 1.0])
    length = np.linalg.norm(upright)
    normal_by_slopes = (np.eye(3) - np.outer(plane.normal, plane.normal)) / length @ -np.eye(3, 2)
    # On a tilted plane, a unit shift of a sole along x or y acts as a shift of -a or -b along z.
    heights_by_soles = np.kron(np.eye(count), upright[None, :])
    return np.asarray(plane.normal), normal_by_slopes @ plane.gain[:2] @ heights_by_soles
