"""Predicts a scan before its first frame: in which rows of the picture each stripe can appear, and its laser plane."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from guara_perception.arrays import Float
from guara_perception.calibration.calibration import Calibration
from guara_perception.calibration.height_rows import plane_in_frame, row_bands
from guara_perception.settings import Settings

# Bands reach this far beyond the height limits, so that a stripe just outside of these is seen as such.
LIMIT_MARGIN_M = 0.025
# Rows added at the edges of a band, for smoothing and for the window about the centre.
ROW_MARGIN_PX = 8


@dataclass(frozen=True, slots=True)
class StripeGeometry:
    """One stripe of the pattern.

    Attributes:
        index: index in the standard pattern.
        plane_in_camera: (4,) laser plane n . X + d = 0 in the camera frame.
        band: first and end row in which the stripe can appear; (0, 0) when it is out of view.
    """

    index: int
    plane_in_camera: Float
    band: tuple[int, int]


@dataclass(frozen=True, slots=True)
class ScanGeometry:
    """All stripes of a scan as seen from one stance.

    Attributes:
        transform_camera_to_footprint: (4, 4).
        stripes: those stripes of the pattern that are calibrated, by index and in its order.
        planes_in_footprint: (s, 4) their laser planes in base_footprint, in the same order.
        sensor_origins: positions (3,) of the camera and (3,) of the laser, the point of the mirror axis nearest to the
            camera [m].
    """

    transform_camera_to_footprint: Float
    stripes: dict[int, StripeGeometry]
    planes_in_footprint: Float
    sensor_origins: tuple[Float, Float]

    def pixels(self, calibration: Calibration, points_in_footprint: Float) -> Float:
        """Picture positions (n, 2) of points (n, 3) in base_footprint."""
        rotation, translation = (
            self.transform_camera_to_footprint[:3, :3],
            self.transform_camera_to_footprint[:3, 3],
        )
        return calibration.camera.project((points_in_footprint - translation) @ rotation)


def scan_geometry(
    calibration: Calibration, transform_base_to_footprint: Float, settings: Settings, mode: str
) -> ScanGeometry:
    """Predict a scan from the calibration and the pose that follows from the stance."""
    transform = transform_base_to_footprint @ calibration.transform_camera_to_base
    pattern = set(settings.pattern(mode))
    planned = [stripe for stripe in calibration.stripes if stripe.index in pattern]
    planes = np.array([stripe.plane for stripe in planned]).reshape(-1, 4)
    height_limits = np.array([settings.minimum_height - LIMIT_MARGIN_M, settings.maximum_height + LIMIT_MARGIN_M])
    bands = row_bands(calibration.camera, transform, planes, height_limits, ROW_MARGIN_PX)
    stripes = {
        stripe.index: StripeGeometry(stripe.index, stripe.plane, band)
        for stripe, band in zip(planned, bands, strict=True)
    }
    camera = transform[:3, 3]
    every_plane = plane_in_frame(np.array([stripe.plane for stripe in calibration.stripes]), transform)
    return ScanGeometry(
        transform, stripes, plane_in_frame(planes, transform), (camera, laser_origin(every_plane, camera))
    )


def laser_origin(planes: Float, near: Float) -> Float:
    """The point of the mirror axis nearest to `near`: all laser planes pass (almost) through that line.

    Args:
        planes: (s, 4) planes of all stripes in one frame.
        near: (3,) a point in the same frame, for instance the optical centre.

    Returns:
        (3,) point in that frame. The axis is the line that fits all planes in the least-squares sense.
    """
    normals, offsets = planes[:, :3], planes[:, 3]
    axis = np.linalg.svd(normals)[2][-1]
    rows = np.vstack((normals, axis))
    return np.linalg.lstsq(rows, np.append(-offsets, axis @ near), rcond=None)[0]
