"""The world on a fine raster: heights, slopes and materials ready for ray casting."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np

from guara_perception.arrays import Array, Codes, Float32
from guara_perception.simulation.world import World

# Finer than a stripe is wide; walls become slopes of this width.
CELL_M = 0.001
# The texture repeats after 1 m.
TEXTURE_CELLS = 512
TEXTURE_CELL_M = 1.0 / TEXTURE_CELLS


@dataclass(frozen=True, slots=True)
class Relief:
    """Raster a[iy, ix] of a world; beyond its border the outermost cells are repeated.

    Attributes:
        origin: x and y of the corner of cell (0, 0) [m].
        cell: edge of a cell [m].
        height: (ny, nx) float32 [m].
        slope: (ny, nx, 2) float32, d height / dx and / dy.
        material: (ny, nx) uint8, index into MATERIALS.
        texture: (n, n) float32 of mean 0 and standard deviation 1, repeating after 1 m.
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
        """Rasterise a world; the last one is kept, for another rangefinder in it."""
        heights, material = world.raster(world.x, world.y, cell)
        height = heights.astype(np.float32)
        slope = np.dstack([_slope(height, cell, axis) for axis in (0, 1)]).astype(np.float32)
        return Relief((world.x[0], world.y[0]), cell, height, slope, material, _texture(world.seed))

    def sample(self, layer: Array, x: Float32, y: Float32, interpolation: int = cv2.INTER_LINEAR) -> Any:
        """Values of a layer at points (h, w) [m]."""
        column = (x - np.float32(self.origin[0])) * np.float32(1 / self.cell) - np.float32(0.5)
        row = (y - np.float32(self.origin[1])) * np.float32(1 / self.cell) - np.float32(0.5)
        return cv2.remap(layer, column, row, interpolation, borderMode=cv2.BORDER_REPLICATE)

    def sample_texture(self, x: Float32, y: Float32) -> Float32:
        """Texture at points (h, w) [m]."""
        scale = np.float32(1 / TEXTURE_CELL_M)
        picture = cv2.remap(self.texture, x * scale, y * scale, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
        return np.asarray(picture, dtype=np.float32)


def _slope(height: Float32, cell: float, axis: int) -> Array:
    """Central differences along x (0) or y (1)."""
    along = (1, 0) if axis == 0 else (0, 1)
    return cv2.Sobel(height, cv2.CV_32F, *along, ksize=1, scale=1 / (2 * cell), borderType=cv2.BORDER_REPLICATE)


def _texture(seed: int) -> Float32:
    """Mottles of several sizes, from 2 mm to 40 mm."""
    noise = np.random.default_rng(seed).standard_normal((TEXTURE_CELLS, TEXTURE_CELLS)).astype(np.float32)
    total = np.zeros_like(noise)
    for sigma, share in ((0.7, 1.0), (2.5, 0.8), (8.0, 0.3)):
        # Wrapped around, so that the tiles meet without a seam.
        wide = cv2.copyMakeBorder(noise, 32, 32, 32, 32, cv2.BORDER_WRAP)
        soft = cv2.GaussianBlur(wide, (0, 0), sigma)[32:-32, 32:-32]
        total += share * soft / soft.std()
    return np.asarray((total - total.mean()) / total.std(), dtype=np.float32)
