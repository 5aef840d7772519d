"""`ScanSurface`: the points of stripes in, the layers of the scan's grids out, as often as they are asked for."""

from __future__ import annotations

import functools
from collections.abc import Mapping

import numpy as np

from guara_perception.arrays import Array, Index, Mask
from guara_perception.calibration.calibration import Calibration
from guara_perception.own_body import OwnBody
from guara_perception.ranging.scan_geometry import ScanGeometry
from guara_perception.ranging.stripe_points import StripePoints
from guara_perception.ranging.surface_raster import SurfaceRaster
from guara_perception.settings import Settings
from guara_perception.terrain.assessment.causes import LookPlan, UnknownCauses
from guara_perception.terrain.assessment.raster import pool, pool_flags
from guara_perception.terrain.layers.geometry import GridGeometry
from guara_perception.terrain.scan.scan_area import ScanArea, area_rows, check_area

# The raster need not be finer than this; coarser grids are pooled from it, so a lost stripe always leaves a gap.
FINEST_CELL_M = 0.005


class ScanSurface:
    """What a scan has seen of the ground; what has not changed since it was last asked is not computed again."""

    def __init__(
        self,
        cell: float,
        geometry: ScanGeometry,
        calibration: Calibration,
        settings: Settings,
        pattern: range,
        body: OwnBody,
    ) -> None:
        """Start with nothing seen.

        Args:
            cell: edge of the cells [m].
            geometry: geometry of the scan.
            calibration: calibration of the rangefinder.
            settings: settings of the robot.
            pattern: indices of the stripes of the scan's mode.
            body: body of the robot at the stance of the scan.

        Raises:
            InvalidInput: the resolution does not divide the footprint.
        """
        self._order = np.array(list(geometry.stripes), dtype=np.int64)
        self._pattern = pattern
        planes, size, origins = geometry.planes_in_footprint, calibration.camera.size, geometry.sensor_origins

        def area(grid: GridGeometry, rows: slice) -> ScanArea:
            plan = LookPlan(grid, planes, lambda points: geometry.pixels(calibration, points), size)
            return ScanArea(grid, rows, plan, UnknownCauses(plan, origins, grid, body.hides), settings.limits)

        rows = area_rows(settings, cell)
        self._grids = {name: grid for name, (grid, _) in rows.items()}
        # Made when they are asked for: most scans are asked for one of them.
        self._area = functools.cache(lambda name: area(*rows[name]))
        self._pooling = max(int(np.ceil(cell / FINEST_CELL_M - 1e-9)), 1)
        fine = self.grid("wide").refined(self._pooling)
        self._raster = SurfaceRaster(fine, pattern, settings.join_height)

    def grid(self, area: str) -> GridGeometry:
        """The cells of an area, "footprint" or "wide".

        Raises:
            InvalidInput: another area.
        """
        check_area(area)
        return self._grids[area]

    @property
    def stripes(self) -> dict[int, StripePoints]:
        """Points of the stripes added so far, by ascending index."""
        return self._raster.stripes

    @property
    def pairs(self) -> Index:
        """(ny, nx) index of the first stripe of the pair that passes over each cell on flat ground, -1 where none."""
        footprint = self._area("footprint")
        pairs = footprint.plan.pairs(np.arange(footprint.grid.size))
        return np.append(self._order, -1)[pairs].reshape(footprint.grid.shape)

    def add(self, stripes: Mapping[int, StripePoints]) -> None:
        """Take stripes by index, one or several: faster, with the same result."""
        self._raster.add(stripes)

    def layers(self, area: str) -> dict[str, Array]:
        """All layers of an area's grid by name, read-only, of what was added so far.

        Raises:
            InvalidInput: no such area.
        """
        check_area(area)
        raster = pool(self._raster.raster(), self._pooling)
        marks = pool_flags(self._raster.marks(), self._pooling)
        usable = np.isin(self._order, list(self.stripes))
        pair_usable = usable[:-1] & usable[1:] & (np.diff(self._order) == self._pattern.step)
        return self._area(area).layers(raster, marks, pair_usable)

    def lost_cells(self, layers: Mapping[str, Array], is_lost: Mask, area: str) -> list[list[int]]:
        """Cells over which stripes were fired whose frames were lost; see `terrain.assessment.lost_cells`.

        Args:
            layers: layers of the area.
            is_lost: (s,) whether a stripe of the pattern was fired and has no usable frame.
            area: "footprint" or "wide".
        """
        return self._area(area).lost(layers, is_lost)
