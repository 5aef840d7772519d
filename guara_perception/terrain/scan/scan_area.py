"""The two areas that a scan's grid can have: the footprint, and the same with what the scan saw beside it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from guara_perception.arrays import Array, Float, Mask
from guara_perception.exceptions import InvalidInput
from guara_perception.settings import Settings
from guara_perception.terrain.assessment.assess import assess_layers
from guara_perception.terrain.assessment.causes import LookPlan, unknown_causes
from guara_perception.terrain.assessment.lost_cells import lost_cells
from guara_perception.terrain.assessment.raster import Raster
from guara_perception.terrain.layers.geometry import GridGeometry

AREAS = ("footprint", "wide")
# Share of a cell that rounding may take.
ROUNDING = 1e-6


@dataclass(frozen=True, slots=True)
class ScanArea:
    """An area of a scan.

    Attributes:
        grid: its cells.
        rows: of the widest area's raster that are its own.
        plan: where each of its cells should have been looked at.
    """

    grid: GridGeometry
    rows: slice
    plan: LookPlan

    def layers(
        self,
        raster: Raster,
        marks: Array,
        pair_usable: Mask,
        sensor_origins: tuple[Float, ...],
        hides: Callable[[Float], Mask],
        settings: Settings,
    ) -> dict[str, Array]:
        """All layers of the area; arguments as of `unknown_causes`, raster and marks of the widest area."""
        own = raster.window((self.rows, slice(None)))
        causes = unknown_causes(
            own.elevation, self.plan, pair_usable, marks[self.rows], sensor_origins, self.grid, hides
        )
        layers = assess_layers(own, causes, self.grid.resolution, settings.limits)
        seen = np.isfinite(own.elevation)
        layers["age"] = np.where(seen, 0, 255).astype(np.uint8)
        layers["looks"] = seen.astype(np.uint8)
        return layers

    def lost(self, layers: Mapping[str, Array], is_lost: Mask) -> list[list[int]]:
        """Cells over which stripes without a usable frame (s,) passed, as `lost_cells` gives them."""
        if not is_lost.any():
            return []
        in_view = self.plan.in_view(np.arange(self.grid.size)).reshape(self.grid.shape)
        planes = self.plan.planes_in_footprint
        elevation = np.asarray(layers["elevation"], np.float64)
        return lost_cells(elevation, np.asarray(layers["hazard"], np.uint16), in_view, planes, is_lost, self.grid)


def scan_areas(settings: Settings, cell: float, plan: Callable[[GridGeometry], LookPlan]) -> dict[str, ScanArea]:
    """Both areas by their names in AREAS.

    The wide one has the footprint's x and reaches along y as far as the map, in whole cells: the camera sees more of
    the ground the farther that is, and what it saw there the map can use when the robot has come to it.

    Args:
        settings: of the robot.
        cell: edge of the cells [m].
        plan: of the looks at the cells of a grid.

    Raises:
        InvalidInput: the resolution does not divide the footprint.
    """
    footprint = GridGeometry.over(settings.footprint_x, settings.footprint_y, cell)
    (low, high), (map_low, map_high) = settings.footprint_y, settings.map_y
    right, left = (max(int(np.floor(more / cell + ROUNDING)), 0) for more in (low - map_low, map_high - high))
    ny, nx = footprint.shape
    wide = GridGeometry((footprint.origin[0], footprint.origin[1] - right * cell), cell, (right + ny + left, nx))
    rows = slice(right, right + ny), slice(0, right + ny + left)
    return {
        name: ScanArea(grid, own, plan(grid)) for name, grid, own in zip(AREAS, (footprint, wide), rows, strict=True)
    }


def check_area(area: str) -> None:
    """Refuse what is none of AREAS.

    Raises:
        InvalidInput: unknown area.
    """
    if area not in AREAS:
        raise InvalidInput(f"area is {area!r}, allowed: {', '.join(AREAS)}")
