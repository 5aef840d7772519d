"""The two areas that a scan's grid can have: the footprint, and the same with what the scan saw beside it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from guara_perception.arrays import Array, Flags, Mask
from guara_perception.exceptions import InvalidInput
from guara_perception.settings import Settings, TraversabilityLimits
from guara_perception.terrain.assessment.causes import LookPlan, UnknownCauses
from guara_perception.terrain.assessment.lost_cells import lost_cells
from guara_perception.terrain.assessment.raster import Raster
from guara_perception.terrain.assessment.reassessment import Reassessment
from guara_perception.terrain.layers.geometry import GridGeometry

AREAS = ("footprint", "wide")
# Share of a cell that rounding may take.
ROUNDING = 1e-6


class ScanArea:
    """An area of a scan; what has not changed since its layers were last asked for is not computed again.

    Attributes:
        grid: cells of the area.
        plan: the looks that the scan should have at them.
    """

    def __init__(
        self, grid: GridGeometry, rows: slice, plan: LookPlan, causes: UnknownCauses, limits: TraversabilityLimits
    ) -> None:
        """Start with nothing seen.

        Args:
            grid: the cells.
            rows: rows of the widest area's raster that belong to this area.
            plan: plan of the looks at the cells.
            causes: causes of its unknown cells.
            limits: what the feet can bear.
        """
        self.grid, self.plan = grid, plan
        self._rows, self._causes = rows, causes
        self._assessment = Reassessment(grid.resolution, limits)

    def layers(self, raster: Raster, marks: Flags, pair_usable: Mask) -> dict[str, Array]:
        """All layers of the area; arguments as of `UnknownCauses.flags`, raster and marks of the widest area."""
        own = raster.window((self._rows, slice(None)))
        layers = self._assessment.layers(own, self._causes.flags(own.elevation, pair_usable, marks[self._rows]))
        seen = np.isfinite(own.elevation)
        return {**layers, "age": np.where(seen, 0, 255).astype(np.uint8), "looks": seen.astype(np.uint8)}

    def lost(self, layers: Mapping[str, Array], is_lost: Mask) -> list[list[int]]:
        """Cells over which stripes without a usable frame (s,) passed, as `lost_cells` gives them."""
        if not is_lost.any():
            return []
        in_view = self.plan.in_view(np.arange(self.grid.size)).reshape(self.grid.shape)
        planes = self.plan.planes_in_footprint
        elevation = np.asarray(layers["elevation"], np.float64)
        return lost_cells(elevation, np.asarray(layers["hazard"], np.uint16), in_view, planes, is_lost, self.grid)


def area_rows(settings: Settings, cell: float) -> dict[str, tuple[GridGeometry, slice]]:
    """The grid of each of AREAS, and its rows within the widest one.

    The wide one has the footprint's x and reaches along y as far as the map, in whole cells: the camera sees more of
    the ground the farther that is, and what it saw there the map can use when the robot has come to it.

    Args:
        settings: settings of the robot.
        cell: edge of the cells [m].

    Raises:
        InvalidInput: the resolution does not divide the footprint.
    """
    footprint = GridGeometry.over(settings.footprint_x, settings.footprint_y, cell)
    (low, high), (map_low, map_high) = settings.footprint_y, settings.map_y
    right, left = (max(int(np.floor(more / cell + ROUNDING)), 0) for more in (low - map_low, map_high - high))
    ny, nx = footprint.shape
    wide = GridGeometry((footprint.origin[0], footprint.origin[1] - right * cell), cell, (right + ny + left, nx))
    rows = slice(right, right + ny), slice(0, right + ny + left)
    return dict(zip(AREAS, zip((footprint, wide), rows, strict=True), strict=True))


def check_area(area: str) -> None:
    """Refuse what is none of AREAS.

    Raises:
        InvalidInput: unknown area.
    """
    if area not in AREAS:
        raise InvalidInput(f"area is {area!r}, allowed: {', '.join(AREAS)}")
