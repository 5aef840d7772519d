"""Fusion of a scan into the cells of the map: resampling to these cells, and update of their memory."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from guara_perception.arrays import Flags, Float, Index
from guara_perception.exceptions import InvalidInput
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.layers.geometry import GridGeometry
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK, Hazard
from guara_perception.terrain.map.fuse_heights import LOOKED_AT, Heights, MapPause, forget_heights, fuse_heights
from guara_perception.terrain.map.odom_cells import OdomCells, Squares

# Standard deviation of the assumed error of calibration and mount, common to all heights of a scan and independent
# between scans.
LOOK_SIGMA_M = 0.0005
# Distance between neighbouring heights for which the variance of resampling is computed [cells].
TURNED_CELLS = 3
SEEN_LAYERS = ("elevation", "variance", "variance_local", "elevation_min", "elevation_max", "slope")


def fuse_scan(cells: OdomCells, terrain: TerrainGrid, now: MapPause, tilt: Float) -> int:
    """Resample a scan to the cells of the map in its area, and fuse it.

    Map cells get the values of the nearest scan cell. A map cell that touches a scan cell without a usable return
    counts as empty, because part of it was observed without a return.

    Args:
        cells: memory of the map, with its window around the robot.
        terrain: grid of the scan alone.
        now: pause of the scan.
        tilt: (2, 2) covariance of the scan's tilt about x and y of its footprint [rad^2].

    Returns:
        Number of heights that disagree with the map.
    """
    transform = now.transform_footprint_to_odom
    slot, x, y = _cells_in_area(cells, terrain, transform)
    iy, ix = terrain.geometry.indices(x, y)
    hazard = scan_flags(terrain)
    own = hazard[iy, ix] & UNKNOWN_MASK
    no_return = _touched_flags(hazard, terrain.geometry, x, y, transform) & LOOKED_AT
    is_empty = no_return != 0
    is_seen, is_unseen = (own == 0) & ~is_empty, (own != 0) & ~is_empty
    layers = {name: terrain.layers[name][iy[is_seen], ix[is_seen]].astype(np.float64) for name in SEEN_LAYERS}
    heights = _heights(layers, terrain, slot[is_seen], x[is_seen], y[is_seen], transform, tilt)
    accepted = fuse_heights(cells, heights, now)
    forget_heights(cells, slot[is_empty], no_return[is_empty])
    unseen, cause, memory = slot[is_unseen], own[is_unseen], cells.memory
    # The memory keeps the most specific cause: UNSCANNED replaces no other cause, and none in LOOKED_AT is replaced.
    is_free = np.isnan(memory["height"][unseen]) & ((memory["cause"][unseen] & LOOKED_AT) == 0)
    better = is_free & (cause != np.uint16(Hazard.UNSCANNED))
    memory["cause"][unseen[better]] = cause[better]
    return int((~accepted).sum())


def _cells_in_area(cells: OdomCells, terrain: TerrainGrid, transform: Float) -> tuple[Index, Float, Float]:
    """Slots (n,) of the map cells in the area of a scan, and their centres x and y (n,) in its footprint [m]."""
    grid, resolution = terrain.geometry, cells.resolution
    (x0, y0), (ny, nx) = grid.origin, grid.shape
    corners = np.array([(x0 + i * nx * grid.resolution, y0 + j * ny * grid.resolution) for i in (0, 1) for j in (0, 1)])
    corners_in_odom = corners @ transform[:2, :2].T + transform[:2, 3]
    (low_x, low_y), (high_x, high_y) = corners_in_odom.min(axis=0), corners_in_odom.max(axis=0)
    cy, cx = cells.cells_between((low_x, low_y), (high_x, high_y))
    slot = cells.slots(cy, cx)
    # Offsets of the cell centres from the footprint, first along the axes of odom, then along those of the footprint.
    offset_x, offset_y = (cx + 0.5) * resolution - transform[0, 3], (cy + 0.5) * resolution - transform[1, 3]
    (xx, xy), (yx, yy) = np.linalg.inv(transform[:2, :2])
    x, y = xx * offset_x + xy * offset_y, yx * offset_x + yy * offset_y
    if np.any(transform[:2, 2]):
        # If the z axes of footprint and odom differ, the height of a cell shifts it horizontally.
        height = np.nan_to_num(np.asarray(terrain.height_at(x, y), dtype=np.float64))
        offset_x, offset_y = offset_x - height * transform[0, 2], offset_y - height * transform[1, 2]
        x, y = xx * offset_x + xy * offset_y, yx * offset_x + yy * offset_y
    used = np.flatnonzero(grid.contains(*grid.indices(x, y)) & (slot >= 0))
    return slot[used], x[used], y[used]


def _heights(
    layers: Mapping[str, Float], terrain: TerrainGrid, slot: Index, x: Float, y: Float, transform: Float, tilt: Float
) -> Heights:
    """Heights (n,) of map cells at x and y (n,) of the footprint, from the layers of the nearest scan cells."""
    height = layers["elevation"]
    relief = layers["elevation_max"] - layers["elevation_min"]
    steepness = np.tan(np.nan_to_num(layers["slope"])) ** 2
    resolution = terrain.resolution
    # The nearest cell is up to half a cell away, and the ground within a cell has relief.
    moved = (steepness * resolution**2 + relief**2) / 12
    # Neighbours share the slope and, unless the grid is rotated, the offset from the nearest cell.
    hidden = np.maximum(relief - np.sqrt(steepness) * resolution, 0.0)
    # The variance due to the stance pose is subtracted, because odometry accounts for it. In grids of earlier versions,
    # `variance` does not contain it.
    variance = np.maximum(layers["variance"] - pose_variance(terrain, x, y), layers["variance_local"])
    variance += tilt[0, 0] * y**2 + tilt[1, 1] * x**2 - 2 * tilt[0, 1] * x * y
    variance += LOOK_SIGMA_M**2 + moved
    return Heights(
        slot=slot,
        height=transform[2, 0] * x + transform[2, 1] * y + transform[2, 2] * height + transform[2, 3],
        variance=variance,
        local=layers["variance_local"] + hidden**2 / 12 + resampling_variance(steepness, resolution, transform),
        distance=np.sqrt(x * x + y * y),
        below=np.maximum(height - layers["elevation_min"], 0.0),
        above=np.maximum(layers["elevation_max"] - height, 0.0),
        steepness=steepness,
    )


def resampling_variance(steepness: Float, resolution: float, transform: Float) -> Float:
    """Variance, not shared by neighbours, of heights taken from the nearest cell of a rotated grid [m^2].

    The nearest centre is up to half a cell away. Without rotation, this offset is the same for all cells. With a
    rotation of more than a few degrees, the offsets of cells that are TURNED_CELLS apart are independent.

    Args:
        steepness: (n,) tan^2 of the slopes.
        resolution: cell edge [m].
        transform: (4, 4) from one grid to the other.
    """
    turned = min(TURNED_CELLS * abs(float(transform[1, 0])), 0.5)
    return np.asarray(steepness * resolution**2 * min(turned * (1 - turned) / 2, 1 / 12))


def _touched_flags(hazard: Flags, grid: GridGeometry, x: Float, y: Float, transform: Float) -> Flags:
    """Union of the flags of the scan cells touched by each map cell; x and y (n,) are centres of map cells."""
    if not x.size:
        return np.empty(0, np.uint16)
    half = 0.5 * grid.resolution * (abs(transform[0, 0]) + abs(transform[1, 0]))
    squares = Squares.of(grid, x, y, half)
    (iy, ix), (ny, nx) = squares.first, squares.shape
    # Padded by one cell, for map cells that extend over the border.
    return squares.joined(np.pad(hazard, 1)[iy + 1 : iy + 1 + ny, ix + 1 : ix + 1 + nx], np.bitwise_or)


def scan_flags(terrain: TerrainGrid) -> Flags:
    """Flags of a scan's cells; unknown cells of a fired stripe whose frame was lost are also DROPOUT.

    Raises:
        InvalidInput: the grid is a map, `lost_cells` of its metadata is not a list of runs, or a run is in a column
            beyond this grid.
    """
    hazard = np.array(terrain.hazard)
    lost = np.zeros(terrain.shape, dtype=bool)
    terrain.record.check("lost_cells")
    try:
        for ix, first, end in terrain.scan_record.lost_cells or ():
            lost[first:end, ix] = True
    except IndexError:
        raise InvalidInput("lost_cells of the metadata is not a list of [ix, first iy, end iy] on this grid") from None
    unknown = (hazard & UNKNOWN_MASK) != 0
    hazard[lost & unknown] |= np.uint16(Hazard.DROPOUT)
    return hazard


def pose_variance(terrain: TerrainGrid, x: Float, y: Float) -> Float:
    """Variance of heights in base_footprint due to the stance pose [m^2]; 0 if its covariance is unknown.

    Rotations (rx, ry) about the footprint's axes and a shift z raise the point (x, y) by z + rx y - ry x.
    """
    terrain.record.check("pose_covariance")
    covariance = terrain.record.pose_covariance
    if covariance is None:
        return np.zeros(np.shape(x))
    by = np.stack((np.ones_like(x), y, -x))
    return np.asarray(np.einsum("in,ij,jn->n", by, covariance[2:5, 2:5], by))
