"""The variance of heights that comes from what their calibration does not know: plane, lens and mount."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from guara_perception.arrays import Float
from guara_perception.calibration.calibration import Calibration
from guara_perception.calibration.height_sigma import HeightUncertainty
from guara_perception.ranging.scan_geometry import ScanGeometry

VarianceOfPoints = Callable[[Float], Float]


def calibration_variance(
    calibration: Calibration, geometry: ScanGeometry
) -> Callable[[Sequence[int]], VarianceOfPoints | None]:
    """For s stripe indices a function of points (3, s, n) in base_footprint that gives variances (s, n) [m^2].

    A calibration that holds no covariance (one made from a drawing) has None for every stripe.

    Args:
        calibration: that locates the points.
        geometry: of the scan.

    Raises:
        FileFormatError: the covariance of the calibration is not as documented.
    """
    uncertainty = HeightUncertainty.of(calibration)

    def of_stripes(indices: Sequence[int]) -> VarianceOfPoints | None:
        if uncertainty is None:
            return None
        return lambda points: uncertainty.variance_of_scan(
            indices,
            np.array([geometry.stripes[index].plane_in_camera for index in indices]),
            points,
            geometry.transform_camera_to_footprint,
            calibration.transform_camera_to_base,
        )

    return of_stripes
