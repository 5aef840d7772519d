"""Laser-off image of a scan, which shows the texture of the ground."""

from __future__ import annotations

from dataclasses import dataclass

from guara_perception.arrays import Float, Grey
from guara_perception.calibration.calibration import CameraModel
from kinematics.arrays import FrozenArrays


@dataclass(frozen=True, slots=True, eq=False)
class GroundPicture(FrozenArrays):
    """Laser-off image of a scan, with lens and pose of the camera.

    Attributes:
        grey: (h, w) grey levels.
        camera: intrinsic model of the camera.
        transform_camera_to_footprint: (4, 4) pose of the camera when the image was taken.
    """

    grey: Grey
    camera: CameraModel
    transform_camera_to_footprint: Float
