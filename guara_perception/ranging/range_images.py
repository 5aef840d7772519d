"""Range images of a scan: the perspective one on floor pixels and the orthorectified one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from guara_perception.arrays import Float, Float32
from guara_perception.ranging.stripe_points import StripePoints
from guara_perception.ranging.surface import scan_surface
from guara_perception.readonly import readonly
from guara_perception.terrain.assessment.raster import merge, rasterise
from guara_perception.terrain.layers.geometry import GridGeometry

# Picture size of the paper: rows along x, columns along y.
ROWS, COLUMNS = 512, 640


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
    clouds = [surface.points.T for _, surface in scan_surface(points, pattern, join_height, pixel)]
    cloud = np.concatenate(clouds) if clouds else np.empty((0, 3))
    return RangeImages(_draw(cloud, x, y), _draw(to_floor(cloud, camera_position), x, y))


def to_floor(points: Float, camera_position: Float) -> Float:
    """Central projection from the optical centre onto the floor, heights kept: the inverse of eqs. 20 and 21.

    With the nadir (u0', v0') below the optical centre and H its height, eqs. 20 and 21 read
    ortho = (perspective - nadir) (H - h) / H + nadir; here they are solved for the perspective position.

    Args:
        points: (n, 3) in base_footprint.
        camera_position: (3,) optical centre in base_footprint.
    """
    nadir, above = camera_position[:2], camera_position[2]
    stretched = points.copy()
    stretched[:, :2] = nadir + (points[:, :2] - nadir) * (above / (above - points[:, 2:3]))
    return stretched


def to_ortho(points: Float, camera_position: Float) -> Float:
    """Orthorectification, eqs. 20 and 21 about the nadir: floor positions of the perspective image to true ones."""
    nadir, above = camera_position[:2], camera_position[2]
    moved = points.copy()
    moved[:, :2] = (points[:, :2] - nadir) * (above - points[:, 2:3]) / above + nadir
    return moved


def _draw(points: Float, x: tuple[float, float], y: tuple[float, float]) -> Float32:
    """Heights [mm] on the picture's pixels, which are not square: scaled to unit cells first."""
    scaled = np.column_stack(
        (
            (points[:, 0] - x[0]) * (ROWS / (x[1] - x[0])),
            (points[:, 1] - y[0]) * (COLUMNS / (y[1] - y[0])),
            points[:, 2],
        )
    )
    unit = GridGeometry((0.0, 0.0), 1.0, (COLUMNS, ROWS))
    raster = merge([rasterise(scaled, np.zeros(len(scaled)), unit)], unit)
    return np.ascontiguousarray(raster.elevation.T * 1e3, dtype=np.float32)
