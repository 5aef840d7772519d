"""Adds to the variance of points what their calibration does not know: plane, lens and mount."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

from guara_perception.calibration.calibration import Calibration
from guara_perception.calibration.height_sigma import HeightUncertainty
from guara_perception.ranging.scan_geometry import ScanGeometry
from guara_perception.ranging.stripe_points import StripePoints


def calibration_variance(
    calibration: Calibration, geometry: ScanGeometry
) -> Callable[[int, StripePoints], StripePoints]:
    """A function of (stripe index, points) that gives the points with the larger variance.

    A calibration that holds no covariance (one made from a drawing) leaves them as they are.

    Args:
        calibration: that locates the points.
        geometry: of the scan.

    Raises:
        FileFormatError: the covariance of the calibration is not as documented.
    """
    uncertainty = HeightUncertainty.of(calibration)

    def widened(index: int, points: StripePoints) -> StripePoints:
        if uncertainty is None:
            return points
        extra = uncertainty.variance_of_scan(
            index,
            calibration.stripe(index).plane,
            points.points,
            geometry.transform_camera_to_footprint,
            calibration.transform_camera_to_base,
        )
        return dataclasses.replace(points, variance=points.variance + extra)

    return widened
