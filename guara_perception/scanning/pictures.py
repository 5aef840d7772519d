"""Range images of a scan's grid: heights, causes of unknown pixels, standard deviations."""

from __future__ import annotations

import dataclasses

import numpy as np

from guara_perception.arrays import Array, Float32, Image
from guara_perception.ranging.range_images import COLUMNS, ROWS, range_images
from guara_perception.scanning.scan_processor import ScanProcessor
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK, Hazard


def with_pictures(terrain: TerrainGrid, processor: ScanProcessor | None = None) -> TerrainGrid:
    """Copy of a grid with the range images of its scan; without a processor, all pixels are unknown.

    The images cover the area of the grid. Pixels of the orthorectified image over unknown cells are NaN, so that
    contradictory returns are not shown.
    """
    if processor is None:
        nothing = np.full((ROWS, COLUMNS), np.nan, np.float32)
        return dataclasses.replace(terrain, pictures={"ortho_image_mm": nothing, "range_image_mm": nothing})
    settings, geometry = processor.settings, terrain.geometry
    ny, nx = geometry.shape
    images = range_images(
        processor.points,
        settings.pattern(processor.mode),
        processor.camera_position,
        (geometry.origin[0], geometry.origin[0] + nx * geometry.resolution),
        (geometry.origin[1], geometry.origin[1] + ny * geometry.resolution),
        settings.join_height,
    )
    ortho = np.where(np.isnan(_under_pixels(terrain, terrain.elevation)), np.float32(np.nan), images.ortho_image_mm)
    return dataclasses.replace(terrain, pictures={"ortho_image_mm": ortho, "range_image_mm": images.range_image_mm})


def cause_image(terrain: TerrainGrid) -> Image:
    """Flags (512, 640) with the cause of each unknown orthorectified pixel; 0 where the height is known.

    The flags are those of the cell under the pixel, or UNSCANNED if that cell is known from other pixels.
    """
    flags = (_under_pixels(terrain, terrain.hazard) & UNKNOWN_MASK).astype(np.uint8)
    flags[flags == 0] = Hazard.UNSCANNED
    return np.where(np.isnan(terrain.pictures["ortho_image_mm"]), flags, 0).astype(np.uint8)


def sigma_image_mm(terrain: TerrainGrid) -> Float32:
    """Standard deviation (512, 640) of the height of the cell under each orthorectified pixel [mm]; NaN if unknown."""
    sigma = np.sqrt(_under_pixels(terrain, terrain.variance)) * 1e3
    return np.where(np.isnan(terrain.pictures["ortho_image_mm"]), np.nan, sigma).astype(np.float32)


def _under_pixels(terrain: TerrainGrid, layer: Array) -> Array:
    """Value (512, 640) of a layer of the footprint's grid in the cell under the centre of each pixel."""
    geometry = terrain.geometry
    ny, nx = geometry.shape
    x = geometry.origin[0] + (np.arange(ROWS) + 0.5) * nx * geometry.resolution / ROWS
    y = geometry.origin[1] + (np.arange(COLUMNS) + 0.5) * ny * geometry.resolution / COLUMNS
    return np.asarray(layer[geometry.indices(x[:, None], y[None, :])])
