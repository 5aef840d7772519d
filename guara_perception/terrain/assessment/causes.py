"""Causes of unknown cells: not scanned, hidden, out of range, ambiguous, or without a return."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from guara_perception.arrays import Flags, Float, Index, Mask
from guara_perception.stripes.kernel.library import address, addresses, kernel
from guara_perception.terrain.assessment.raster import ROUNDING
from guara_perception.terrain.layers.geometry import GridGeometry
from guara_perception.terrain.layers.hazard import Hazard

# Height by which a surface must exceed a line of sight to block it [m].
HIDING_MARGIN_M = 0.001
# Number of cells on each side of a cell that are nearby: 0.1 m in all on a 5 mm grid.
NEARBY = 10
# Number of cells that are compared with all laser planes at once.
CELLS_TOGETHER = 256
# Value of a cell that is not computed yet.
NOT_ASKED = -2
# Lowest assumed height of the ground that light may reach after it has crossed other rows of the grid [m].
DEEPEST_M = -0.2
# Largest distance, in addition to half a cell, at which the outermost stripe counts as meeting the last known cell of a
# row [m]. It allows for the slope of the ground within the cell, and for samples cut off at the end of a stripe.
END_MARGIN_M = 0.0005
# Offsets from the assumed height at which the ground of a cell is also tried [m]. From one to the next, the area in
# view grows by less than two cells.
ELSEWHERE_M = np.arange(-20, 11) * 0.01


class LookPlan:
    """Stripe pair and visibility of each grid cell in a scan of flat ground, computed on first use.

    Attributes:
        geometry: the grid.
        planes_in_footprint: (s, 4) laser planes in the order of the pattern.
    """

    def __init__(
        self,
        geometry: GridGeometry,
        planes_in_footprint: Float,
        project: Callable[[Float], Float],
        size: tuple[int, int],
    ) -> None:
        """Create the plan; no cell is computed yet.

        Args:
            geometry: the grid.
            planes_in_footprint: (s, 4) laser planes in the order of the pattern, at least one.
            project: function that returns image positions (n, 2) of points (n, 3) in base_footprint, NaN behind the
                camera.
            size: image width and height [px].
        """
        self.geometry, self._project, self._size = geometry, project, size
        self.planes_in_footprint = planes_in_footprint
        self._pairs = np.full(geometry.size, NOT_ASKED, dtype=np.int32)
        self._in_view = np.full(geometry.size, NOT_ASKED, dtype=np.int8)

    def pairs(self, cells: Index) -> Index:
        """Positions (n,) in the pattern of the first stripe of the pair that encloses each cell; -1 without a pair."""
        new = cells[self._pairs[cells] == NOT_ASKED]
        # In blocks, because all cells and all laser planes at once would take megabytes.
        for begin in range(0, new.size, CELLS_TOGETHER):
            block = new[begin : begin + CELLS_TOGETHER]
            self._pairs[block] = self._find_pairs(block)
        return self._pairs[cells].astype(np.intp)

    def in_view(self, cells: Index) -> Mask:
        """Mask (n,) of the cells whose centres are in the camera's view if their ground is at z = 0."""
        new = cells[self._in_view[cells] == NOT_ASKED]
        if new.size:
            self._in_view[new] = self.sees(self.points(new, 0.0))
        return self._in_view[cells] > 0

    def is_lit(self, points: Float, pair_usable: Mask) -> Mask:
        """Mask (n,) of the points (n, 3) in base_footprint between the outermost usable stripes."""
        usable = np.flatnonzero(pair_usable)
        if not usable.size:
            return np.zeros(len(points), dtype=bool)
        before, after = self.planes_in_footprint[[usable[0], usable[-1] + 1]]
        return np.asarray((points @ before[:3] > -before[3]) != (points @ after[:3] > -after[3]))

    def unmet(self, elevation: Float, pair_usable: Mask, laser_origin: Float) -> Mask:
        """Mask (ny, nx) of the cells beyond the first or last usable stripe in each row.

        If the first usable stripe meets the ground in the first known cell of a row, no light reached the nearer cells,
        because all other usable stripes land farther away. The same holds for the last stripe and the last known cell.
        Light may cross several rows on its way from the laser; the condition must hold in each of them.

        Args:
            elevation: (ny, nx) heights [m], NaN where unknown.
            pair_usable: (s - 1,) mask of the pairs of neighbouring stripes that both have usable frames.
            laser_origin: position (3,) of the laser.
        """
        usable = np.flatnonzero(pair_usable)
        if not usable.size:
            return np.zeros(self.geometry.shape, dtype=bool)
        ends = self.planes_in_footprint[[usable[0], usable[-1] + 1]]
        arrays = [np.ascontiguousarray(values, np.float64) for values in (ends, *self.geometry.centres())]
        elevation, laser = (np.ascontiguousarray(values, np.float64) for values in (elevation, laser_origin))
        tolerance = self.geometry.resolution / 2 + END_MARGIN_M
        work, unmet = np.empty(2 * len(elevation) + 1, np.int64), np.empty(elevation.shape, np.bool_)
        given = address(elevation), *elevation.shape, *addresses(*arrays), self.geometry.resolution, tolerance
        kernel().unmet_cells(*given, DEEPEST_M, *addresses(laser, work, unmet))
        return unmet

    def _find_pairs(self, cells: Index) -> Index:
        x, y = self._centres(cells)
        a, b, _, d = self.planes_in_footprint.T[:, :, None]
        side = a * x + (b * y + d) > 0
        # A cell belongs to the first pair of planes between which it lies.
        still = np.logical_and.accumulate(side[1:] == side[0], axis=0)
        return np.where(still.all(axis=0), -1, still.sum(axis=0))

    def sees(self, points: Float) -> Mask:
        """Mask (n,) of the points (n, 3) in base_footprint that are in the camera's view."""
        x, y = self._project(points).T
        with np.errstate(invalid="ignore"):
            return np.asarray((x >= 0) & (y >= 0) & (x <= self._size[0] - 1) & (y <= self._size[1] - 1))

    def points(self, cells: Index, heights: Float | float) -> Float:
        """Points (n, 3) at the centres of cells, at heights (n,) or one height [m]."""
        points = np.empty((len(cells), 3))
        points[:, 0], points[:, 1] = self._centres(cells)
        points[:, 2] = heights
        return points

    def _centres(self, cells: Index) -> tuple[Float, Float]:
        x, y = self.geometry.centres()
        iy, ix = np.divmod(cells, x.size)
        return x[ix], y[iy]


def unknown_causes(
    plan: LookPlan,
    sensor_origins: tuple[Float, ...],
    elevation: Float,
    pair_usable: Mask,
    marks: Flags,
    in_own_shadow: Callable[[Index, Float], Mask] | None = None,
) -> Flags:
    """Compute the causes of unknown cells.

    Args:
        plan: stripe pair and visibility of each cell.
        sensor_origins: positions (3,) of the camera and, last, the laser in base_footprint.
        elevation: (ny, nx) heights [m], NaN where unknown.
        pair_usable: (s - 1,) mask of the pairs of neighbouring stripes that both have usable frames.
        marks: (ny, nx) flags of unusable returns.
        in_own_shadow: function that returns the mask of the cells (n,) whose points (n, 3) the robot hides from its own
            camera or laser; None if it hides none.

    Returns:
        (ny, nx) uint16: one or more unknown flags where the elevation is NaN, 0 elsewhere.
    """
    unknown = np.isnan(elevation)
    flags = np.where(unknown, marks, 0).astype(np.uint16)
    cells = np.flatnonzero(unknown & (flags == 0))
    # Without a pair, the index -1 selects the appended entry, which is False.
    looked_at = np.append(pair_usable, False)[plan.pairs(cells)] & plan.in_view(cells)
    looked_at &= ~plan.unmet(elevation, pair_usable, sensor_origins[-1]).ravel()[cells]
    targets = lowest_ground(elevation, cells, plan.geometry)
    looked_at[looked_at] = _could_be_met(plan, sensor_origins, elevation, pair_usable, targets[looked_at])
    flags.ravel()[cells[~looked_at]] = np.uint16(Hazard.UNSCANNED)
    cells, targets = cells[looked_at], targets[looked_at]
    why = np.full(cells.size, Hazard.DROPOUT, dtype=np.uint16)
    why[behind_surface(elevation, targets, np.array(sensor_origins), plan.geometry)] = Hazard.OCCLUDED
    if in_own_shadow is not None and cells.size:
        why[in_own_shadow(cells, targets)] = Hazard.SELF
    flags.ravel()[cells] = why
    return flags


def _could_be_met(
    plan: LookPlan,
    sensor_origins: tuple[Float, ...],
    elevation: Float,
    pair_usable: Mask,
    targets: Float,
) -> Mask:
    """Mask of the targets (n, 3) in the camera's view, or lit and in view if the ground is at another height.

    On ground that rises towards the camera, less is in view than the plan for flat ground expects. A target outside
    the view was not observed, unless the ground there may be so much lower or higher that a stripe meets it in view.
    Rays of light and lines of sight reach lower ground only if they cross no measured ground at the target's height.
    """
    met = plan.sees(targets)
    for offset in ELSEWHERE_M:
        if not (unmet := np.flatnonzero(~met)).size:
            break
        moved = targets[unmet] + (0.0, 0.0, offset)
        reached = plan.sees(moved) & plan.is_lit(moved, pair_usable)
        unmet, moved = unmet[reached], moved[reached]
        level, is_hidden = targets[unmet, 2] - 2 * HIDING_MARGIN_M, np.zeros(unmet.size, dtype=bool)
        for origin in sensor_origins if offset < 0 else ():
            passed = origin + ((origin[2] - level) / (origin[2] - moved[:, 2]))[:, None] * (moved - origin)
            iy, ix = plan.geometry.indices(passed[:, 0], passed[:, 1])
            inside = np.flatnonzero(plan.geometry.contains(iy, ix))
            is_hidden[inside] |= elevation[iy[inside], ix[inside]] > level[inside] + HIDING_MARGIN_M
        met[unmet] = ~is_hidden
    return met


def behind_surface(elevation: Float, targets: Float, sensor_origins: npt.ArrayLike, geometry: GridGeometry) -> Mask:
    """Mask of the targets (n, 3) that the measured surface hides from a sensor at (3,), or from any of (k, 3)."""
    top = float(np.fmax.reduce(elevation, axis=None, initial=np.nan))
    if np.isnan(top) or not len(targets):
        return np.zeros(len(targets), dtype=bool)
    # Positions outside the grid are clipped to a border of unknown cells, one cell wide.
    around = np.full((elevation.shape[0] + 2, elevation.shape[1] + 2), np.nan, np.float32)
    around[1:-1, 1:-1] = elevation
    offset = np.array([1 + ROUNDING - origin / geometry.resolution for origin in geometry.origin])
    targets, sensors = (np.ascontiguousarray(values, np.float64) for values in (targets, sensor_origins))
    hidden = np.empty(len(targets), np.bool_)
    given = address(around), *around.shape, address(targets), len(targets), address(sensors), sensors.size // 3
    # The part of a line above the highest surface cannot be blocked, so only the rest is tested.
    kernel().behind_surface(*given, top, geometry.resolution, address(offset), HIDING_MARGIN_M, address(hidden))
    return hidden


def lowest_ground(elevation: Float, cells: Index, geometry: GridGeometry) -> Float:
    """Centres (n, 3) of cells, at the lowest height measured nearby, or at height 0 if none was measured nearby."""
    x, y = geometry.centres()
    iy, ix = np.divmod(cells, x.size)
    elevation = np.ascontiguousarray(elevation, np.float64)
    work, lowest = np.empty(elevation.shape[1] + 2 * NEARBY), np.empty(elevation.shape)
    kernel().lowest_nearby(address(elevation), *elevation.shape, NEARBY, *addresses(work, lowest))
    heights = lowest.ravel()[cells]
    return np.stack((x[ix], y[iy], np.where(np.isinf(heights), 0.0, heights))).T
