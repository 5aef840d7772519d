"""Fine raster of a world (`Relief`), and visibility of the ground from a viewpoint above it (`PolarView`).

In a polar view, the angle of a line of sight is measured from straight down. A point at distance r and height z has the
tangent r / (viewpoint height - z) and is hidden if a nearer point on the same bearing has a larger tangent. Visibility
therefore follows from the running maximum of the tangent along the distance. The inverse of this function gives the
point at which a line of sight meets the ground.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np

from guara_perception.arrays import Array, Codes, Float, Float32, Mask
from guara_perception.simulation.world import World

# Edge of a cell, smaller than the width of a stripe. Vertical walls become slopes of this width.
CELL_M = 0.001
# Number of cells along each side of the texture, which repeats after 1 m.
TEXTURE_CELLS = 512
TEXTURE_CELL_M = 1.0 / TEXTURE_CELLS
# Tolerances of the visibility test, for the error of the raster.
IN_FRONT_M = 0.0025
TANGENT_TOLERANCE = 0.001
# Difference between the interpolated and the nearest tabulated distance that indicates a depth edge.
EDGE_M = 0.001


@dataclass(frozen=True, slots=True)
class Relief:
    """Raster a[iy, ix] of a world; a point outside it has the values of the nearest cell.

    Attributes:
        origin: x and y of the corner of cell (0, 0) [m].
        cell: edge of a cell [m].
        height: (ny, nx) float32 [m].
        slope: (ny, nx, 2) float32, d height / dx and / dy.
        material: (ny, nx) uint8, index into MATERIALS.
        texture: (n, n) float32 with mean 0 and standard deviation 1, repeated every 1 m.
    """

    origin: tuple[float, float]
    cell: float
    height: Float32
    slope: Float32
    material: Codes
    texture: Float32

    @staticmethod
    @lru_cache(maxsize=1)
    def of(world: World, cell: float = CELL_M) -> Relief:
        """Rasterise a world. The last raster is cached, so that several rangefinders can share it."""
        heights, material = world.raster(world.x, world.y, cell)
        height = heights.astype(np.float32)
        slope = np.dstack([_slope(height, cell, axis) for axis in (0, 1)]).astype(np.float32)
        return Relief((world.x[0], world.y[0]), cell, height, slope, material, _texture(world.seed))

    def sample(self, layer: Array, x: Float32, y: Float32, interpolation: int = cv2.INTER_LINEAR) -> Any:
        """Values of a layer at points with coordinates x (h, w) and y (h, w) [m]."""
        column = (x - np.float32(self.origin[0])) * np.float32(1 / self.cell) - np.float32(0.5)
        row = (y - np.float32(self.origin[1])) * np.float32(1 / self.cell) - np.float32(0.5)
        return cv2.remap(layer, column, row, interpolation, borderMode=cv2.BORDER_REPLICATE)

    def sample_texture(self, x: Float32, y: Float32) -> Float32:
        """Texture at points with coordinates x (h, w) and y (h, w) [m]."""
        scale = np.float32(1 / TEXTURE_CELL_M)
        picture = cv2.remap(self.texture, x * scale, y * scale, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
        return np.asarray(picture, dtype=np.float32)


def _slope(height: Float32, cell: float, axis: int) -> Array:
    """Slope along x (`axis` 0) or y (1), by central differences."""
    along = (1, 0) if axis == 0 else (0, 1)
    return cv2.Sobel(height, cv2.CV_32F, *along, ksize=1, scale=1 / (2 * cell), borderType=cv2.BORDER_REPLICATE)


def _texture(seed: int) -> Float32:
    """Mottled texture with patches of 2 mm to 40 mm."""
    noise = np.random.default_rng(seed).standard_normal((TEXTURE_CELLS, TEXTURE_CELLS)).astype(np.float32)
    total = np.zeros_like(noise)
    for sigma, share in ((0.7, 1.0), (2.5, 0.8), (8.0, 0.3)):
        # The filter wraps around, so that repeated tiles have no seam.
        wide = cv2.copyMakeBorder(noise, 32, 32, 32, 32, cv2.BORDER_WRAP)
        soft = cv2.GaussianBlur(wide, (0, 0), sigma)[32:-32, 32:-32]
        total += share * soft / soft.std()
    return np.asarray((total - total.mean()) / total.std(), dtype=np.float32)


@dataclass(frozen=True, slots=True)
class PolarView:
    """Visibility around a viewpoint: running maximum of the tangent along every bearing.

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
        """Compute the view from a viewpoint.

        Args:
            relief: the ground.
            viewpoint: (3,) position in the world [m], above all ground within the radius.
            bearing_range: first and last bearing [rad].
            bearing_count: number of bearings.
            radius: largest distance [m].
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
        """Horizontal distance (h, w) at which lines of sight (h, w) meet the ground [m], at most the largest radius.

        Args:
            bearing: bearings of the lines of sight [rad].
            tangent: tangents of their angles from straight down.
            tangents: number of tangents in the inverse table.
        """
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
        # At a depth edge, interpolation between near and far would give a point in the air.
        return np.where(np.abs(smooth - nearest) < np.float32(EDGE_M), smooth, nearest)

    def sees(self, points: Float32) -> Mask:
        """Mask of the points (h, w, 3) that are visible."""
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
