"""Mirror model, in which the planes of all stripes are reflections of a fixed laser plane in a rotating mirror."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import numpy.typing as npt

from guara_perception.arrays import Float
from guara_perception.calibration.calibration import plane_in_frame
from kinematics.arrays import FrozenArrays


@dataclass(frozen=True, slots=True)
class MirrorModel(FrozenArrays):
    """Fixed laser plane and rotating mirror in a common frame; the axis lies approximately in the mirror's face.

    At mirror angle theta, the fixed laser plane is reflected in a mirror with the normal m = Rot(axis, gain theta) m0.
    The reflected plane is n = (I - 2 m m') n0, d = d0 + 2 (n0 . m)(m . q), which rotates by 2 gain theta.

    Attributes:
        laser_plane: (4,) plane n0 . X + d0 = 0 of the light before the mirror, n0 a unit vector.
        axis: (3,) unit vector of the axis; positive angles follow the right-hand rule.
        point: (3,) point q on the axis [m].
        normal_at_zero: (3,) unit normal m0 of the mirror at theta = 0.
        gain: ratio of the true to the commanded mirror angle.
    """

    laser_plane: Float
    axis: Float
    point: Float
    normal_at_zero: Float
    gain: float

    def planes(self, mirror_angles: npt.ArrayLike) -> Float:
        """Reflected laser planes (n, 4), with unit normals, at mirror angles (n,) [rad]."""
        turn = self.gain * np.asarray(mirror_angles, dtype=np.float64)
        c, s = np.cos(turn)[:, None], np.sin(turn)[:, None]
        m0, axis = self.normal_at_zero, self.axis
        normal = m0 * c + _cross(axis, m0) * s + axis * (axis @ m0) * (1 - c)
        n0, d0 = self.laser_plane[:3], self.laser_plane[3]
        along = normal @ n0
        reflected = n0 - 2 * along[:, None] * normal
        return np.column_stack((reflected, d0 + 2 * along * (normal @ self.point)))

    def in_frame(self, transform: Float) -> MirrorModel:
        """Transform the model to another frame, given the (4, 4) transform to that frame."""
        rotation, translation = transform[:3, :3], transform[:3, 3]
        return MirrorModel(
            laser_plane=plane_in_frame(self.laser_plane, transform),
            axis=rotation @ self.axis,
            point=rotation @ self.point + translation,
            normal_at_zero=rotation @ self.normal_at_zero,
            gain=self.gain,
        )

    def to_dict(self) -> dict[str, Any]:
        """Convert the model to JSON values."""
        return {each.name: np.asarray(getattr(self, each.name)).tolist() for each in fields(self)}


def nominal_mirror(point: Float) -> MirrorModel:
    """Nominal mirror in base_link or another frame with x forward and z up.

    The axis passes through `point` and is parallel to y. The laser plane points straight down at angle zero and forward
    at positive angles. The incoming light is horizontal and meets a mirror inclined by 45 degrees; this is a
    convention, because only the reflected plane is observed.
    """
    half = np.sqrt(0.5)
    return MirrorModel(
        laser_plane=np.array([0.0, 0.0, -1.0, point[2]]),
        axis=np.array([0.0, -1.0, 0.0]),
        point=np.asarray(point, dtype=np.float64),
        normal_at_zero=np.array([half, 0.0, half]),
        gain=1.0,
    )


# Parameters of the deviation from the nominal mirror (see `perturbed_mirror`), and their generous prior standard
# deviations.
PARAMETERS = {
    "laser_pitch": 0.15,
    "laser_roll": 0.05,
    "laser_offset": 0.010,
    "axis_yaw": 0.08,
    "axis_roll": 0.08,
    "axis_x": 0.040,
    "axis_z": 0.040,
    "mirror_tilt": 0.03,
    "gain": 0.02,
}


def perturbed_mirror(nominal: MirrorModel, parameters: Float) -> MirrorModel:
    """Apply deviations, in the order of PARAMETERS, to a nominal mirror.

    laser_pitch rotates the incoming plane about the axis [rad], laser_roll tilts this plane relative to the axis [rad],
    and laser_offset shifts it off the axis [m]. axis_yaw and axis_roll rotate the axis about z and x [rad]; axis_x and
    axis_z shift it [m]. mirror_tilt tilts the mirror's face relative to the axis [rad]. gain is the relative change of
    the model's gain.
    """
    pitch, roll, offset, yaw, tip, x, z, tilt, gain = parameters
    axis = nominal.axis + _cross(np.array([tip, 0.0, yaw]), nominal.axis)
    axis = axis / np.linalg.norm(axis)
    flat = nominal.normal_at_zero - axis * (axis @ nominal.normal_at_zero)
    flat = flat / np.linalg.norm(flat)
    incoming = nominal.laser_plane[:3] - axis * (axis @ nominal.laser_plane[:3])
    incoming = incoming / np.linalg.norm(incoming)
    across = _cross(axis, incoming)
    normal = np.cos(roll) * (np.cos(pitch) * incoming + np.sin(pitch) * across) + np.sin(roll) * axis
    point = nominal.point + np.array([x, 0.0, z])
    return MirrorModel(
        laser_plane=np.append(normal, offset - normal @ point),
        axis=axis,
        point=point,
        normal_at_zero=np.cos(tilt) * flat + np.sin(tilt) * axis,
        gain=nominal.gain * (1 + gain),
    )


def _cross(one: Float, other: Float) -> Float:
    """Cross product of two vectors (3,), identical to `np.cross` in every bit but ten times faster."""
    (a, b, c), (d, e, f) = one.tolist(), other.tolist()
    return np.array([b * f - c * e, c * d - a * f, a * e - b * d])
