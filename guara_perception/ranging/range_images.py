"""Range images of a scan: the perspective one on floor pixels and the orthorectified one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from guara_perception.arrays import Array, Float, Float32
from guara_perception.ranging.groups import in_groups
from guara_perception.ranging.stripe_points import StripePoints
from guara_perception.ranging.surface import surface_keys, surface_of
from guara_perception.readonly import readonly
from guara_perception.terrain.assessment.raster import ROUNDING, TOP_LAYER_M

# Picture size of the paper: rows along x, columns along y.
ROWS, COLUMNS = 512, 640
# Stripes and pairs whose samples are made and summed in one go: with more of them they no longer fit into the cache.
TOGETHER = 2


@dataclass(frozen=True, slots=True)
class RangeImages:
    """Heights as pictures, (512, 640) float32 [mm above z = 0], NaN where unknown.

    Pixel (r, c) is x = x_min + (r + 0.5) * depth / 512, y = y_min + (c + 0.5) * width / 640 in base_footprint.

    Attributes:
        ortho_image_mm: orthorectified: every height at its true position.
        range_image_mm: perspective: every height where the camera's ray through it meets the floor.
    """

    ortho_image_mm: Float32
    range_image_mm: Float32

    def __post_init__(self) -> None:
        """Freeze the pictures."""
        object.__setattr__(self, "ortho_image_mm", readonly(self.ortho_image_mm))
        object.__setattr__(self, "range_image_mm", readonly(self.range_image_mm))


def range_images(
    points: Mapping[int, StripePoints],
    pattern: range,
    camera_position: Float,
    x: tuple[float, float],
    y: tuple[float, float],
    join_height: float,
) -> RangeImages:
    """Draw both range images from organised points.

    Args:
        points: stripes by index.
        pattern: indices of the stripes of the scan's mode.
        camera_position: (3,) optical centre in base_footprint.
        x, y: the area in base_footprint [m].
        join_height: largest height difference of one surface [m].
    """
    pixel = min((x[1] - x[0]) / ROWS, (y[1] - y[0]) / COLUMNS)
    ortho, perspective = _Picture(x, y), _Picture(x, y)
    for group in in_groups(surface_keys(points, pattern), TOGETHER):
        cloud = surface_of(points, group, pattern, join_height, pixel).points
        known = np.isfinite(cloud[2])
        px, py, height = cloud if known.all() else cloud[:, known]
        if not height.size:
            continue
        height = height.copy()
        ortho.add(px, py, height)
        perspective.add(*to_floor(px, py, height, camera_position), height)
    return RangeImages(ortho.mean_mm(), perspective.mean_mm())


def to_floor(x: Float, y: Float, height: Float, camera_position: Float) -> tuple[Float, Float]:
    """Central projection from the optical centre onto the floor: the inverse of eqs. 20 and 21.

    With the nadir (u0', v0') below the optical centre and H its height, eqs. 20 and 21 read
    ortho = (perspective - nadir) (H - h) / H + nadir; here they are solved for the perspective position.

    Args:
        x, y, height: (n,) of points in base_footprint [m].
        camera_position: (3,) optical centre in base_footprint.

    Returns:
        x and y on the floor, (n,) each.
    """
    nadir_x, nadir_y, above = camera_position.tolist()
    stretch = above / (above - height)
    return (x - nadir_x) * stretch + nadir_x, (y - nadir_y) * stretch + nadir_y


class _Picture:
    """Sums samples per pixel: the top layer of each, apart from what lies below it (see `assessment.raster`).

    Only the samples' pixels and heights are kept until all are there, since each may raise the top of its pixel.
    """

    def __init__(self, x: tuple[float, float], y: tuple[float, float]) -> None:
        self._along_x = _PixelAxis(x, ROWS)
        self._along_y = _PixelAxis(y, COLUMNS)
        self._highest = np.full((ROWS + 2) * (COLUMNS + 2), -np.inf)
        self._samples: list[tuple[int, Array, Float]] = []

    def add(self, x: Float, y: Float, height: Float) -> None:
        """Take samples at x and y (n,) of heights (n,), one or more, all known."""
        pixel = self._along_x.numbers(x)
        pixel *= COLUMNS + 2
        pixel += self._along_y.numbers(y)
        # Counted from the first one of this group: sums over a few rows stay in the processor's cache.
        first = int(pixel.min())
        pixel -= first
        # As numpy counts indices: with any other type `at` is many times slower.
        np.maximum.at(self._highest[first:], pixel.astype(np.intp), height)
        self._samples.append((first, pixel, height))

    def mean_mm(self) -> Float32:
        """Mean height (ROWS, COLUMNS) of the top layer of each pixel [mm], NaN where no sample fell."""
        total, count = np.zeros((2, self._highest.size))
        bottom = self._highest - TOP_LAYER_M
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


class _PixelAxis:
    """Numbers of the pixels along one axis of a picture, from 1: 0 and one more than there are lie beyond it."""

    def __init__(self, limits: tuple[float, float], count: int) -> None:
        self._per_metre = count / (limits[1] - limits[0])
        self._offset = 1 + ROUNDING - limits[0] * self._per_metre
        self._last = np.int32(count + 1)

    def numbers(self, positions: Float) -> Array:
        """Numbers (n,) int32 at positions (n,) [m]."""
        # In place: new memory for each step would cost more than the work.
        scaled = positions * self._per_metre
        scaled += self._offset
        numbers = scaled.astype(np.int32)
        return np.clip(numbers, np.int32(0), self._last, out=numbers)
