"""Why a cell is unknown: not looked at, hidden, out of range, doubtful, or simply no return."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from guara_perception.arrays import Flags, Float, Index, Mask
from guara_perception.terrain.assessment.raster import ROUNDING
from guara_perception.terrain.layers.geometry import GridGeometry
from guara_perception.terrain.layers.hazard import Hazard

# A surface must rise this far above a line of sight to count as hiding what lies beyond.
HIDING_MARGIN_M = 0.001
# Cells that are compared with all laser planes together.
CELLS_TOGETHER = 256
# Lines from ground to sensor that are followed together.
LINES_TOGETHER = 256


@dataclass(frozen=True, slots=True)
class LookPlan:
    """The looks that a scan should have at the cells of a grid if the ground is flat; for the cells asked for.

    Attributes:
        geometry: the grid.
        planes_in_footprint: (s, 4) laser planes in the order of the pattern, at least one.
        project: gives picture positions (n, 2) of points (n, 3) in base_footprint, NaN where behind the camera.
        size: picture width and height [px].
    """

    geometry: GridGeometry
    planes_in_footprint: Float
    project: Callable[[Float], Float]
    size: tuple[int, int]

    def pairs(self, cells: Index) -> Index:
        """Position in the pattern of the first stripe of each cell's pair (n,), -1 where no pair passes over it."""
        # All cells of a grid and all laser planes at once would take megabytes.
        blocks = np.split(cells, range(CELLS_TOGETHER, cells.size, CELLS_TOGETHER))
        return np.concatenate([self._pairs(block) for block in blocks])

    def _pairs(self, cells: Index) -> Index:
        x, y = self._centres(cells)
        a, b, _, d = self.planes_in_footprint.T[:, :, None]
        side = a * x + (b * y + d) > 0
        # The first pair whose planes have a cell on different sides passes over it: planes are counted up to there.
        still = np.logical_and.accumulate(side[1:] == side[0], axis=0)
        return np.where(still.all(axis=0), -1, still.sum(axis=0))

    def in_view(self, cells: Index) -> Mask:
        """Whether the camera sees the centre of each cell (n,)."""
        x, y = self._centres(cells)
        pixels = self.project(np.column_stack((x, y, np.zeros(cells.size))))
        with np.errstate(invalid="ignore"):
            inside = (pixels[:, 0] <= self.size[0] - 1) & (pixels[:, 1] <= self.size[1] - 1)
            return np.asarray((pixels >= 0).all(axis=1) & inside)

    def _centres(self, cells: Index) -> tuple[Float, Float]:
        x, y = self.geometry.centres()
        iy, ix = np.divmod(cells, x.size)
        return x[ix], y[iy]


def unknown_causes(
    elevation: Float,
    plan: LookPlan,
    pair_usable: Mask,
    marks: Flags,
    sensor_origins: tuple[Float, ...],
    geometry: GridGeometry,
    in_own_shadow: Callable[[Float], Mask] | None = None,
) -> Flags:
    """Give every unknown cell its cause.

    Args:
        elevation: (ny, nx) heights [m], NaN where unknown.
        plan: what should have been looked at.
        pair_usable: (s - 1,) whether both stripes of a pair were fired with good frames and are neighbours.
        marks: (ny, nx) flags of returns that were seen here and may not be used.
        sensor_origins: positions (3,) of camera and laser in base_footprint.
        geometry: the grid.
        in_own_shadow: says which points (n, 3) the robot hides from its own camera or laser; None = none.

    Returns:
        (ny, nx) uint16, one or more unknown flags where the elevation is NaN, 0 elsewhere.
    """
    unknown = np.isnan(elevation)
    flags = np.where(unknown, marks, 0).astype(np.uint16)
    cells = np.flatnonzero(unknown & (flags == 0))
    # No pair is the last one, which is not usable.
    looked_at = np.append(pair_usable, False)[plan.pairs(cells)] & plan.in_view(cells)
    flags.ravel()[cells[~looked_at]] = np.uint16(Hazard.UNSCANNED)
    cells = cells[looked_at]
    if not cells.size:
        return flags
    targets = _lowest_ground(elevation, cells, geometry)
    cause = np.full(cells.size, Hazard.DROPOUT, dtype=np.uint16)
    for sensor_origin in sensor_origins:
        cause[_behind_surface(elevation, targets, sensor_origin, geometry)] = Hazard.OCCLUDED
    if in_own_shadow is not None:
        cause[in_own_shadow(targets)] = Hazard.SELF
    flags.ravel()[cells] = cause
    return flags


def _behind_surface(elevation: Float, targets: Float, sensor_origin: Float, geometry: GridGeometry) -> Mask:
    """Whether a measured surface stands between a sensor and each of the targets (n, 3)."""
    top = float(np.fmax.reduce(elevation, axis=None))
    x, y, z = targets.T
    if np.isnan(top):
        return np.zeros(len(targets), dtype=bool)
    # Above the highest surface nothing can hide: only the last stretch of each line needs a look.
    climb = np.maximum(sensor_origin[2] - z, 1e-6)
    start = np.clip(1 - (top - z) / climb, 0.0, 1.0)
    length = np.hypot(sensor_origin[0] - x, sensor_origin[1] - y) * (1 - start)
    samples = int(np.clip(np.ceil(2 * length.max() / geometry.resolution), 1, 400))
    # Cells counted with a border of one, where nothing is known: what lies beyond the grid is cut to it.
    around = np.pad(elevation, 1, constant_values=np.nan)
    along = ((np.arange(samples) + 0.5) / samples)[:, None]
    # All lines at once would take megabytes.
    blocks = (slice(first, first + LINES_TOGETHER) for first in range(0, len(targets), LINES_TOGETHER))
    return np.concatenate(
        [
            _is_blocked(around, targets[block], start[block] + (1 - start[block]) * along, sensor_origin, geometry)
            for block in blocks
        ]
    )


def _is_blocked(around: Float, targets: Float, share: Float, sensor_origin: Float, geometry: GridGeometry) -> Mask:
    """Whether the surface rises above the line from a target (n, 3) to a sensor at any of some shares (m, n) of it.

    `around` is the surface with a border of one cell.
    """
    x, y, z = targets.T
    row, column = (
        ((end + share * (position - end) - origin) * (1 / geometry.resolution) + (1 + ROUNDING))
        .clip(0, count + 1)
        .astype(np.intp)
        for position, end, origin, count in (
            (y, sensor_origin[1], geometry.origin[1], geometry.shape[0]),
            (x, sensor_origin[0], geometry.origin[0], geometry.shape[1]),
        )
    )
    row *= around.shape[1]
    row += column
    with np.errstate(invalid="ignore"):
        return np.asarray(
            (around.ravel().take(row) > sensor_origin[2] + share * (z - sensor_origin[2]) + HIDING_MARGIN_M).any(axis=0)
        )


def _lowest_ground(elevation: Float, cells: Index, geometry: GridGeometry) -> Float:
    """Centres (n, 3) of flat cells at the lowest height measured around them, at 0 where nothing is known nearby."""
    x, y = geometry.centres()
    iy, ix = np.divmod(cells, x.size)
    return np.stack((x[ix], y[iy], _ground_height(elevation).ravel()[cells])).T


def _ground_height(elevation: Float) -> Float:
    """Lowest measured height in a neighbourhood of 0.1 m on a 5 mm grid, 0 where nothing is known nearby."""
    far = 1e3
    lowest = cv2.erode(np.where(np.isnan(elevation), far, elevation), np.ones((21, 21), np.uint8))
    return np.where(lowest > far / 2, 0.0, lowest)
