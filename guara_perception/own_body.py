"""The robot's own body in the scan: points that lie on it, and ground that it hides from its camera or laser."""

from __future__ import annotations

import numpy as np

from guara_perception.arrays import Float, Mask
from kinematics import RobotState
from kinematics.self_filter import SelfFilter


class OwnBody:
    """The robot's shapes at one stance, asked in base_footprint."""

    def __init__(
        self, state: RobotState, transform_base_to_footprint: Float, sensor_origins: tuple[Float, ...]
    ) -> None:
        """Place the shapes.

        Args:
            state: state of the robot at the stance.
            transform_base_to_footprint: (4, 4).
            sensor_origins: positions (3,) of camera and laser in base_footprint.
        """
        self._filter = SelfFilter(state, transform_base_to_frame=transform_base_to_footprint)
        self._sensor_origins = sensor_origins

    def contains(self, points: Float) -> Mask:
        """Which points (n, 3) lie on the robot; NaN points do not."""
        return np.asarray(self._filter.contains(points))

    def hides(self, points: Float) -> Mask:
        """Which points (n, 3) the robot hides from its camera or its laser."""
        hidden = np.zeros(len(points), dtype=bool)
        for sensor_origin in self._sensor_origins:
            hidden |= self._filter.blocks(sensor_origin, points)
        return hidden
