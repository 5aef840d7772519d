"""The laser plane of a specimen at any mirror angle, between and beyond the angles of its calibrated stripes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from guara_perception.arrays import Float
from guara_perception.calibration.calibration import Calibration


@dataclass(frozen=True, slots=True)
class LaserPlanes:
    """Planes over the mirror angle: a smooth curve through the planes of all stripes.

    Attributes:
        angles: (s,) mirror angles, ascending [rad].
        planes_in_base: (s, 4) n . X + d = 0 in base_link, n a unit vector pointing ahead.
    """

    angles: Float
    planes_in_base: Float

    @staticmethod
    def of(calibration: Calibration) -> LaserPlanes:
        """The laser planes of a calibrated specimen."""
        stripes = sorted(calibration.stripes, key=lambda stripe: stripe.mirror_angle)
        rotation, translation = (
            calibration.transform_camera_to_base[:3, :3],
            calibration.transform_camera_to_base[:3, 3],
        )
        planes = np.array([stripe.plane for stripe in stripes])
        normals = planes[:, :3] @ rotation.T
        planes = np.column_stack((normals, planes[:, 3] - normals @ translation))
        planes *= np.where(planes[:, :1] < 0, -1.0, 1.0)
        return LaserPlanes(np.array([stripe.mirror_angle for stripe in stripes]), planes)

    def plane_at(self, mirror_angle: float) -> Float:
        """(4,) plane in base_link at a mirror angle [rad].

        Between two stripes the plane turns about their common line, as the mirror turns it; beyond the last ones it
        goes on as between the last two.
        """
        after = int(np.clip(np.searchsorted(self.angles, mirror_angle), 1, len(self.angles) - 1))
        a, b = self.planes_in_base[after - 1], self.planes_in_base[after]
        share = (mirror_angle - self.angles[after - 1]) / (self.angles[after] - self.angles[after - 1])
        turn = np.arccos(np.clip(a[:3] @ b[:3], -1.0, 1.0))
        # Spherical interpolation keeps the rate of turning even; any blend of two planes holds their common line.
        weights = np.array([np.sin((1 - share) * turn), np.sin(share * turn)]) / np.sin(turn)
        plane = weights @ np.array([a, b])
        return np.asarray(plane / np.linalg.norm(plane[:3]))
