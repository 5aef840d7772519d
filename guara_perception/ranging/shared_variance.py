"""Variance that neighbouring heights of a scan share: of its frame, its calibration and an undetected motion."""

from __future__ import annotations

import numpy as np

from guara_perception.arrays import Float
from guara_perception.calibration.height_sigma import HeightUncertainty
from guara_perception.ranging.scan_geometry import ScanGeometry, variance_by_motion


class SharedVariance:
    """Variance of heights in the frame of a scan, without that of single stripe positions and of relief between them.

    A calibrated plane errs along all of its stripe, and those of neighbours are fitted together.
    """

    def __init__(self, geometry: ScanGeometry, pose: Float, motion: Float | None) -> None:
        """Prepare what does not depend on the ground.

        Args:
            geometry: geometry of the scan.
            pose: (6, 6) covariance of the stance pose in base_footprint, as of `StancePose`.
            motion: (6, 6) covariance in `base_link` of camera motion during the scan; None = it stood.

        Raises:
            FileFormatError: the covariance of the calibration is not as documented.
        """
        self._geometry, self._pose = geometry, pose[2:5, 2:5]
        self._calibration = HeightUncertainty.of(geometry.calibration)
        self._motion = np.zeros((3, 3))
        if motion is not None:
            to_base = geometry.calibration.transform_camera_to_base
            turn = geometry.transform_camera_to_footprint[:3, :3] @ to_base[:3, :3].T
            # Components of the motion in base_footprint that change heights: z, and rotations about x and y.
            rows = np.kron(np.eye(2), turn)[2:5]
            self._motion = rows @ motion @ rows.T

    def at(self, points: Float) -> Float:
        """Variances (n,) of the heights of points (3, n) in base_footprint [m^2]."""
        geometry = self._geometry
        transform = geometry.transform_camera_to_footprint
        variance = variance_by_motion(points, np.zeros(3), self._pose)
        variance += variance_by_motion(points, transform[:3, 3], self._motion)
        if self._calibration is not None and points.size:
            planes = geometry.planes_in_footprint
            stripes = np.argmin(np.abs(planes[:, :3] @ points + planes[:, 3:]), axis=0)
            for row, index in enumerate(geometry.stripes):
                own = stripes == row
                variance[own] += self._calibration.variance(
                    [index],
                    geometry.stripes[index].plane_in_camera[None],
                    points[:, None, own],
                    transform,
                    geometry.calibration.transform_camera_to_base,
                )[0]
        return variance
