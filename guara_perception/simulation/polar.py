"""What a viewpoint above a height field sees: along each bearing the first surface that meets a line of sight.

Along one bearing a point at distance r and height z is seen under the tangent r / (viewpoint height - z) from straight
down. What lies behind a larger tangent is hidden, so the running maximum of the tangent says both what a line of sight
meets (its inverse) and whether a given point is in sight.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from guara_perception.arrays import Array, Float, Float32, Mask
from guara_perception.simulation.relief import Relief

# A point counts as in sight of the light although something up to this much in front of it is as high: raster error.
IN_FRONT_M = 0.0025
TANGENT_TOLERANCE = 0.001
# Neighbouring lines of sight that meet the ground further apart than this have an edge between them.
EDGE_M = 0.001


@dataclass(frozen=True, slots=True)
class PolarView:
    """Running maximum of the tangent around a viewpoint.

    Attributes:
        viewpoint: (3,) position in the world [m].
        bearings: first bearing and spacing [rad].
        radius_spacing: spacing of distances [m].
        horizon: (bearings, radii) float32, running maximum of the tangent.
    """

    viewpoint: Float
    bearings: tuple[float, float]
    radius_spacing: float
    horizon: Float32

    @staticmethod
    def around(
        relief: Relief,
        viewpoint: Float,
        bearing_range: tuple[float, float],
        bearing_count: int,
        radius: float,
        radius_spacing: float,
    ) -> PolarView:
        """Compute the view.

        Args:
            relief: the ground.
            viewpoint: (3,) position [m], above all ground within the radius.
            bearing_range: first and last bearing [rad].
            bearing_count: number of bearings.
            radius: how far to look [m].
            radius_spacing: spacing of distances [m].
        """
        first, last = bearing_range
        spacing = (last - first) / (bearing_count - 1)
        bearing = first + spacing * np.arange(bearing_count)
        radii = (np.arange(int(np.ceil(radius / radius_spacing))) + 1) * radius_spacing
        x = viewpoint[0] + np.cos(bearing)[:, None] * radii
        y = viewpoint[1] + np.sin(bearing)[:, None] * radii
        height = relief.sample(relief.height, x.astype(np.float32), y.astype(np.float32))
        drop = np.maximum(np.float32(viewpoint[2]) - height, np.float32(1e-3))
        tangent = radii.astype(np.float32) / drop
        return PolarView(viewpoint, (first, spacing), radius_spacing, np.maximum.accumulate(tangent, axis=1))

    def meets(self, bearing: Float32, tangent: Float32, tangents: int) -> Float32:
        """Distance (h, w) [m] at which lines of sight (h, w) meet the ground; beyond the last radius: level ground."""
        limit = float(np.clip(tangent.max(), 0.01, float(self.horizon[:, -1].max())))
        grid = np.linspace(0.0, limit, tangents, dtype=np.float32)
        radii = (np.arange(self.horizon.shape[1] + 1) * self.radius_spacing).astype(np.float32)
        table = np.empty((len(self.horizon), tangents), dtype=np.float32)
        start = np.zeros(1, np.float32)
        for row, horizon in zip(table, self.horizon, strict=True):
            row[:] = np.interp(grid, np.concatenate((start, horizon)), radii)
        column, row = tangent * np.float32((tangents - 1) / limit), self._row(bearing)
        smooth, nearest = (
            np.asarray(cv2.remap(table, column, row, kind, borderMode=cv2.BORDER_REPLICATE), dtype=np.float32)
            for kind in (cv2.INTER_LINEAR, cv2.INTER_NEAREST)
        )
        # Beside an edge, the mean of near and far would be a point in the air.
        return np.where(np.abs(smooth - nearest) < np.float32(EDGE_M), smooth, nearest)

    def sees(self, points: Float32) -> Mask:
        """Which of the points (h, w, 3) are in sight."""
        dx, dy = points[..., 0] - np.float32(self.viewpoint[0]), points[..., 1] - np.float32(self.viewpoint[1])
        radius = cv2.magnitude(dx, dy)
        tangent = radius / np.maximum(np.float32(self.viewpoint[2]) - points[..., 2], np.float32(1e-3))
        bearing = np.asarray(cv2.phase(dx, dy))
        bearing = np.where(bearing > np.float32(np.pi), bearing - np.float32(2 * np.pi), bearing)
        column = (radius - np.float32(IN_FRONT_M)) * np.float32(1 / self.radius_spacing) - np.float32(1)
        before = cv2.remap(self.horizon, column, self._row(bearing), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(tangent >= before - np.float32(TANGENT_TOLERANCE))

    def _row(self, bearing: Array) -> Float32:
        first, spacing = self.bearings
        return np.asarray((bearing - np.float32(first)) * np.float32(1 / spacing), dtype=np.float32)
