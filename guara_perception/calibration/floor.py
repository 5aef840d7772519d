"""Converts pixels to points on a level plane, the floor or the top of a plate, and back."""

from __future__ import annotations

import numpy as np

from guara_perception.arrays import Float
from guara_perception.calibration.calibration import CameraModel


def floor_pixels(camera: CameraModel, transform_camera_to_footprint: Float, points: Float) -> Float:
    """Pixels (n, 2) of floor points (n, 2)."""
    rotation, translation = transform_camera_to_footprint[:3, :3], transform_camera_to_footprint[:3, 3]
    in_footprint = np.column_stack((points, np.zeros(len(points))))
    return camera.project((in_footprint - translation) @ rotation)


def to_floor(camera: CameraModel, transform_camera_to_footprint: Float, pixels: Float, height: float = 0.0) -> Float:
    """Where the rays of pixels (n, 2) meet the plane z = `height`: x and y (n, 2) in base_footprint."""
    rotation, translation = transform_camera_to_footprint[:3, :3], transform_camera_to_footprint[:3, 3]
    rays = camera.rays(pixels) @ rotation.T
    depth = (height - translation[2]) / rays[:, 2]
    return translation[:2] + rays[:, :2] * depth[:, None]
