"""The variance of heights that comes from what their calibration does not know: plane, lens and mount."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from guara_perception.calibration.calibration import Calibration
from guara_perception.calibration.height_sigma import HeightUncertainty
from guara_perception.ranging.scan_geometry import ScanGeometry

Float = npt.NDArray[np.float64]
VarianceOfPoints = Callable[[Float], Float]


def calibration_variance(calibration: Calibration, geometry: ScanGeometry) -> Callable[[int], VarianceOfPoints | None]:
    """For each stripe index a function of points (n, 3) in base_footprint that gives variances (n,) [m^2].

    A calibration that holds no covariance (one made from a drawing) has None for every index.

    Args:
        calibration: that locates the points.
        geometry: of the scan.

    Raises:
        FileFormatError: the covariance of the calibration is not as documented.
    """
    uncertainty = HeightUncertainty.of(calibration)

    def of_stripe(index: int) -> VarianceOfPoints | None:
        if uncertainty is None:
            return None
        return lambda points: uncertainty.variance_of_scan(
            index,
            geometry.stripes[index].plane_in_camera,
            points,
            geometry.transform_camera_to_footprint,
            calibration.transform_camera_to_base,
        )

    return of_stripe
