"""Points of stripes from their profiles, with all that is known of a scan beforehand."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from guara_perception.arrays import Float, Mask
from guara_perception.calibration.calibration import Calibration
from guara_perception.calibration.height_sigma import HeightUncertainty
from guara_perception.ranging.groups import in_groups
from guara_perception.ranging.locate import Locator
from guara_perception.ranging.scan_geometry import ScanGeometry
from guara_perception.ranging.stripe_points import StripePoints, stripe_points
from guara_perception.stripes.profile import StripeProfile


class StripeRanger:
    """Turns the profiles of a scan's stripes into points."""

    def __init__(
        self,
        calibration: Calibration,
        geometry: ScanGeometry,
        locator: Locator,
        height_limits: tuple[float, float],
        on_robot: Callable[[Float], Mask],
    ) -> None:
        """Keep what does not depend on the frames.

        Args:
            calibration: calibration by which the points are located.
            geometry: geometry of the scan.
            locator: makes points of rows.
            height_limits: lowest and highest height that counts as terrain [m].
            on_robot: says which points (n, 3) in base_footprint lie on the robot itself.

        Raises:
            FileFormatError: the covariance of the calibration is not as documented.
        """
        self._calibration = calibration
        self._geometry = geometry
        self._locator = locator
        self._height_limits = height_limits
        self._on_robot = on_robot
        self._uncertainty = HeightUncertainty.of(calibration)

    def points(self, profiles: Mapping[int, StripeProfile]) -> dict[int, StripePoints]:
        """Points of stripes by index; their frames must not be bad."""
        found: dict[int, StripePoints] = {}
        for group in in_groups(list(profiles)):
            points = stripe_points(
                [profiles[index] for index in group],
                self._locator,
                np.array([self._geometry.stripes[index].plane_in_camera for index in group]),
                self._height_limits,
                self._on_robot,
                self._added_variance(group),
            )
            found.update(zip(group, points, strict=True))
        return found

    def _added_variance(self, indices: Sequence[int]) -> Callable[[Float], Float] | None:
        """Variances (s, n) [m^2] of heights at points (3, s, n) that come from the uncertainty of the calibration.

        None for a calibration without covariance (one made from a drawing).
        """
        uncertainty, calibration, geometry = self._uncertainty, self._calibration, self._geometry
        if uncertainty is None:
            return None
        return lambda points: uncertainty.variance_of_scan(
            indices,
            np.array([geometry.stripes[index].plane_in_camera for index in indices]),
            points,
            geometry.transform_camera_to_footprint,
            calibration.transform_camera_to_base,
        )
