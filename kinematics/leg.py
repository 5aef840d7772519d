"""Closed-form kinematics of a leg of four joints: hip roll and three pitch joints in one plane.

The leg is recognised by its geometry, not by its names: the first axis along x, the others along y, all joints and
the sole in one plane through the first axis, hip roll and hip pitch meeting in one point. Thigh, shank and foot are
vectors in that plane and may point anywhere. With r the sole relative to the hip and phi the sole's pitch in the
leg's plane:

    hip roll     q1 = atan2(r_y, -r_z);   in the plane the sole is at (r_x, -sqrt(r_y^2 + r_z^2))
    ankle        a = sole - Ry(phi) foot
    knee bend    cos b = (|a|^2 - l1^2 - l2^2) / (2 l1 l2), b with the sign of the posture in which the robot stands
    thigh        at the angle psi(a) - atan2(l2 sin b, l1 + l2 cos b) from straight down
    ankle pitch  q4 = phi - q2 - q3

psi(v) is the angle about y that turns "straight down" onto v. Everything is vectorised over soles.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from kinematics.arrays import Float, read_only
from kinematics.tree import KinematicTree

# Tolerance of lengths [m] and axes [-] when a leg is recognised: the closed form must agree with the URDF to rounding.
GEOMETRY_TOLERANCE = 1e-9

# The cosine of a straight knee may exceed 1 by this much.
ROUNDING = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class LegGeometry:
    """Lengths and senses of a four-joint leg.

    Attributes:
        hip: (3,) meeting point of the first two axes in `base_link` [m].
        senses: (4,) +1 where an axis points along x, y, y, y of `base_link`, -1 where it is opposite.
        thigh, shank, foot: (2,) vectors (x, z) in the leg's plane at zero angles [m].
        knee_sign: sign of the knee bend b in the posture in which the robot stands.
        lower, upper: (4,) joint limits [rad].
    """

    hip: Float
    senses: Float
    thigh: Float
    shank: Float
    foot: Float
    knee_sign: float
    lower: Float
    upper: Float

    def soles_in_base(self, joint_positions: npt.ArrayLike) -> Float:
        """Forward kinematics: joint positions (..., 4) [rad] -> sole centres (..., 3) in `base_link` [m]."""
        roll, *pitches = np.moveaxis(np.asarray(joint_positions, dtype=np.float64) * self.senses, -1, 0)
        plane = np.zeros((*roll.shape, 2))
        angle = np.zeros_like(roll)
        for pitch, bone in zip(pitches, (self.thigh, self.shank, self.foot), strict=True):
            angle = angle + pitch
            plane += _turned(bone, angle)
        down = -plane[..., 1]
        return np.stack([plane[..., 0], down * np.sin(roll), -down * np.cos(roll)], axis=-1) + self.hip

    def solve(self, soles_in_base: Float, sole_pitch: Float) -> Float:
        """Inverse kinematics.

        Args:
            soles_in_base: (n, 3) sole centres [m].
            sole_pitch: (n,) pitch of the sole in the leg's plane [rad].

        Returns:
            (n, 4) joint positions [rad] regardless of limits; NaN where the leg is too short or cannot fold that far.
        """
        reach = soles_in_base - self.hip
        roll = np.arctan2(reach[:, 1], -reach[:, 2])
        ankle = np.column_stack([reach[:, 0], -np.hypot(reach[:, 1], reach[:, 2])])
        ankle -= _turned(self.foot, sole_pitch)
        one, two = np.linalg.norm(self.thigh), np.linalg.norm(self.shank)
        cosine = (np.einsum("ni,ni->n", ankle, ankle) - one**2 - two**2) / (2.0 * one * two)
        with np.errstate(invalid="ignore"):
            bend = self.knee_sign * np.arccos(
                np.where(np.abs(cosine) <= 1.0 + ROUNDING, np.clip(cosine, -1.0, 1.0), np.nan)
            )
        thigh = _angle(ankle) - np.arctan2(two * np.sin(bend), one + two * np.cos(bend))
        hip_pitch = thigh - _angle(self.thigh)
        knee = bend + _angle(self.thigh) - _angle(self.shank)
        turns = np.column_stack([roll, hip_pitch, knee, sole_pitch - hip_pitch - knee])
        turns[np.isnan(bend)] = np.nan
        return np.asarray((np.remainder(turns + np.pi, 2.0 * np.pi) - np.pi) * self.senses)


def _turned(vector: Float, angle: Float) -> Float:
    """Vectors (..., 2): the vector (x, z) rotated about y by each of the angles (...)."""
    sine, cosine = np.sin(angle), np.cos(angle)
    return np.stack([vector[0] * cosine + vector[1] * sine, vector[1] * cosine - vector[0] * sine], axis=-1)


def _angle(vectors: Float) -> Float:
    """Angle about y [rad] that turns straight down (0, -1) onto vectors (..., 2)."""
    return np.asarray(np.arctan2(-vectors[..., 0], -vectors[..., 1]))


def find_leg_geometry(tree: KinematicTree, leg: str) -> LegGeometry | None:
    """The geometry of a leg that the closed form fits, or None.

    Raises:
        UnknownName: no such leg.
    """
    config = tree.leg(leg)
    if len(config.joints) != 4:
        return None
    path = tree.urdf.path_to(config.sole)
    transform, axes, origins = np.eye(4), [], []
    for joint in path:
        transform = transform @ joint.transform_child_to_parent
        if joint.kind == "revolute":
            axes.append(transform[:3, :3] @ joint.axis)
            origins.append(transform[:3, 3])
    sole = transform[:3, 3]
    wanted = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
    if len(axes) != 4 or not _close(transform[:3, :3], np.eye(3)):
        return None
    senses = np.sign(np.einsum("ij,ij->i", wanted, axes))
    points = np.array([*origins, sole])
    in_one_plane = _close(points[:, 1], points[0, 1]) and _close(points[1, 2], points[0, 2])
    if not in_one_plane or not _close(np.array(axes), wanted * senses[:, None]):
        return None
    columns = [tree.joint_index(joint) for joint in config.joints]
    lower, upper = tree.lower_limits[columns], tree.upper_limits[columns]
    thigh, shank, foot = (np.delete(points[i + 1] - points[i], 1) for i in (1, 2, 3))
    if min(np.linalg.norm(thigh), np.linalg.norm(shank)) < GEOMETRY_TOLERANCE:
        return None
    bend = senses[2] * tree.nominal[columns[2]] + _angle(shank) - _angle(thigh)
    return LegGeometry(
        hip=read_only(points[1]),
        senses=read_only(senses),
        thigh=read_only(thigh),
        shank=read_only(shank),
        foot=read_only(foot),
        knee_sign=1.0 if bend >= 0.0 else -1.0,
        lower=lower,
        upper=upper,
    )


def _close(a: npt.ArrayLike, b: npt.ArrayLike) -> bool:
    return bool(np.allclose(a, b, rtol=0.0, atol=GEOMETRY_TOLERANCE))
