"""Laser-off image of a scan, which shows the texture of the ground."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from guara_perception.arrays import Float, Grey, Image
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


def grey_picture(picture: Image) -> Grey:
    """Convert a camera image to 8-bit grey levels (h, w); always a copy."""
    if picture.ndim == 3 and picture.shape[2] == 3:
        grey: Image = np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY))
    else:
        grey = picture.reshape(picture.shape[:2]).copy()
    return np.asarray(grey if grey.dtype == np.uint8 else grey // 256, np.uint8)
