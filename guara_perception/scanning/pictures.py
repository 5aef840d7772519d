"""Range images of a scan and its grid: perspective and orthorectified heights, causes, standard deviations."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping

import numpy as np

from guara_perception.arrays import Array, Float, Float32, Image, Index, Mask
from guara_perception.ranging.scan_geometry import in_groups
from guara_perception.ranging.stripe_points import StripePoints
from guara_perception.ranging.surface import EVERYWHERE, Lines, shares, surface_keys, surface_lines
from guara_perception.scanning.scan_processor import ScanProcessor
from guara_perception.terrain.assessment.raster import ROUNDING, TOP_LAYER_M
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK, Hazard

# Image size in the paper (docs/paper.md): rows along x, columns along y.
ROWS, COLUMNS = 512, 640
# Largest magnification by the central projection up to which neighbouring columns of the camera leave no gaps in the
# perspective image.
LARGEST_STRETCH = 1.25
# Largest number of lines added between neighbouring columns of the camera: enough for 4 mm, as on distant ground.
MOST_BETWEEN = 5


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
    images["ortho_image_mm"][np.isnan(_under_pixels(terrain, terrain.elevation))] = np.nan
    return dataclasses.replace(terrain, pictures=images)


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


def range_images(
    points: Mapping[int, StripePoints],
    pattern: range,
    camera_position: Float,
    x: tuple[float, float],
    y: tuple[float, float],
    join_height: float,
) -> dict[str, Float32]:
    """Range images (512, 640) of the points of a scan [mm above z = 0], NaN where unknown, by name.

    In "ortho_image_mm", each height is at its true position; in "range_image_mm", the perspective image, it is where
    the camera's ray through the point meets the floor. The centre of pixel (r, c) in base_footprint is
    x = x_min + (r + 0.5) * (x_max - x_min) / 512 and y = y_min + (c + 0.5) * (y_max - y_min) / 640.

    Args:
        points: points of the stripes, by index.
        pattern: indices of the stripes of the scan's mode.
        camera_position: (3,) optical centre in base_footprint.
        x, y: ranges of the area in base_footprint [m].
        join_height: limit of the height difference between neighbouring points of one surface [m].
    """
    size = np.array([(x[1] - x[0]) / ROWS, (y[1] - y[0]) / COLUMNS])
    nadir, above = camera_position[:2], float(camera_position[2])
    # Row and column of the nadir, counted from 1.
    nadir_px = (nadir - (x[0], y[0])) / size + 1 + ROUNDING
    ortho, perspective = _Picture(), _Picture()
    between = _lines_between(points, size[1])
    keys, y_range = surface_keys(points, pattern), _useful_y(points, (y[0] - size[1], y[1] + size[1]), nadir[1], above)
    for group in in_groups(keys):
        for found, followed in surface_lines(points, group, pattern, join_height, float(size.min()), y_range):
            if not found.opens.size:
                continue
            lines = _filled(found, followed, between) if between else found
            share = shares(lines.number)
            # Pixels relative to the nadir: the central projection is a scaling about it, which eqs. 20 and 21 of the
            # paper undo.
            first, difference = (lines.first[:2] - nadir[:, None]) / size[:, None], lines.difference[:2] / size[:, None]
            row, column, height = (
                share * along + start
                for along, start in zip((*difference, lines.difference[2]), (*first, lines.first[2]), strict=True)
            )
            cut = lines.cut()
            ortho.add(row + nadir_px[0], column + nadir_px[1], height, cut)
            stretch = above / (above - height)
            row *= stretch
            column *= stretch
            perspective.add(row + nadir_px[0], column + nadir_px[1], height, cut)
    return {"ortho_image_mm": ortho.mean_mm(), "range_image_mm": perspective.mean_mm()}


def _lines_between(points: Mapping[int, StripePoints], width: float) -> int:
    """Number of lines to add between neighbouring columns so that pixels of this width [m] are not left empty."""
    apart = [np.nanmax(np.abs(np.diff(stripe.points[:, 1])), initial=0.0) for stripe in points.values()]
    return min(math.ceil(max(apart, default=0.0) * LARGEST_STRETCH / width) - 1, MOST_BETWEEN) if any(apart) else 0


def _filled(lines: Lines, followed: Index, between: int) -> Lines:
    """Add interpolated lines between those of neighbouring columns of the camera.

    Args:
        lines: the given lines.
        followed: positions of the lines whose successor belongs to the next image column.
        between: number of lines added between two neighbours.
    """
    ways = np.arange(1, between + 1) / (between + 1)

    def vectors(own: Float) -> Float:
        first, second = own[:, followed], own[:, followed + 1]
        return np.concatenate([own, *(first * (1 - way) + second * way for way in ways)], axis=1)

    def masks(own: Mask) -> Mask:
        return np.concatenate([own, np.tile(own[followed] | own[followed + 1], between)])

    first, difference = vectors(lines.first), vectors(lines.difference)
    return Lines(first, difference, masks(lines.opens), masks(lines.closes), lines.number)


def _useful_y(
    points: Mapping[int, StripePoints], y_range: tuple[float, float], nadir: float, above: float
) -> tuple[float, float]:
    """Range of y of all points that can fall into `y_range` in one of the two images."""
    heights = np.concatenate([np.zeros(1), *(stripe.points[:, 2] for stripe in points.values())])
    if np.nanmax(heights) >= above:
        return EVERYWHERE
    ends = [nadir + (y - nadir) * (1 - h / above) for y in y_range for h in (np.nanmin(heights), np.nanmax(heights))]
    return min(ends), max(ends)


class _Picture:
    """Mean of the samples in the top layer of each pixel (see `assessment.raster`).

    Pixels and heights of all samples are kept to the end, because any sample may raise the top of its pixel.
    """

    def __init__(self) -> None:
        self._highest = np.full((ROWS + 2) * (COLUMNS + 2), -np.inf)
        self._samples: list[tuple[int, Array, Float]] = []

    def add(self, row: Float, column: Float, height: Float, cut: Index) -> None:
        """Add samples.

        Args:
            row, column: (n, c) row and column of each sample, counted from 1.
            height: (n, c) height of each sample; not copied.
            cut: flat indices of the samples to omit.
        """
        pixel = row.astype(np.int32)
        np.clip(pixel, np.int32(0), np.int32(ROWS + 1), out=pixel)
        # Relative to the first row of this group, so that the sums over a few rows stay in the CPU cache.
        first = int(pixel.min())
        pixel -= np.int32(first)
        pixel *= np.int32(COLUMNS + 2)
        columns = column.astype(np.int32)
        pixel += np.clip(columns, np.int32(0), np.int32(COLUMNS + 1), out=columns)
        pixel, height, first = pixel.reshape(-1), height.reshape(-1), first * (COLUMNS + 2)
        # Pixel 0 is outside the image.
        pixel[cut] = 0
        # np.intp, because `ufunc.at` is many times slower with any other index type.
        np.maximum.at(self._highest[first:], pixel.astype(np.intp), height)
        self._samples.append((first, pixel, height))

    def mean_mm(self) -> Float32:
        """Mean height (ROWS, COLUMNS) of the top layer of each pixel [mm], NaN in pixels without a sample."""
        total, count = np.zeros((2, self._highest.size))
        bottom = self._highest - TOP_LAYER_M
        # The left border column contains the omitted samples. All of them are accepted, so that they do not force a
        # selection below; the mean of this column is discarded.
        bottom[:: COLUMNS + 2] = -np.inf
        for first, pixel, heights in self._samples:
            is_top = heights > bottom[first:].take(pixel)
            if not is_top.all():
                top = np.flatnonzero(is_top)
                pixel, heights = pixel.take(top), heights.take(top)
            sums, numbers = np.bincount(pixel, weights=heights), np.bincount(pixel)
            total[first : first + sums.size] += sums
            count[first : first + numbers.size] += numbers
        with np.errstate(invalid="ignore"):
            mean = (total / count * 1e3).reshape(ROWS + 2, COLUMNS + 2)
        return np.ascontiguousarray(mean[1:-1, 1:-1], dtype=np.float32)
