"""Resampling of a scan to map cells, and fusion of their heights by a gated Kalman filter per cell."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from guara_perception.arrays import Flags, Float, Index, Mask
from guara_perception.exceptions import InvalidInput
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.layers.geometry import GridGeometry
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK, Hazard
from guara_perception.terrain.map.odom_cells import OdomCells, Squares
from guara_perception.terrain.map.walk_correction import SidewaysDrift

# At 3 sigma one correct observation in 370 is rejected; the next one replaces the height.
GATE_SIGMAS = 3.0
# Causes of cells that were observed without a usable height.
LOOKED_AT = np.uint16(Hazard.DROPOUT | Hazard.AMBIGUOUS | Hazard.OUT_OF_RANGE)
# Assumed error, due to calibration and mount, common to all heights of a scan and independent between scans.
LOOK_SIGMA_M = 0.0005
SEEN_LAYERS = ("elevation", "variance", "elevation_min", "elevation_max", "slope")


@dataclass(frozen=True, slots=True)
class OdometryDrift:
    """Variances of the drift of leg odometry since the start.

    Attributes:
        rise: variance of z [m^2].
        shift: variance along x or y, whichever is larger [m^2].
        turn: variance of yaw [rad^2].
    """

    rise: float = 0.0
    shift: float = 0.0
    turn: float = 0.0


@dataclass(frozen=True, slots=True)
class MapPause:
    """Pause at which the map is updated or queried.

    Attributes:
        pause: number of the pause.
        stamp: time on the clock that gives the age of cells [ns].
        drift: present drift of the odometry.
        sideways: sideways drift of the cells.
        transform_footprint_to_odom: (4, 4).
    """

    pause: int
    stamp: int
    drift: OdometryDrift
    sideways: SidewaysDrift
    transform_footprint_to_odom: Float


@dataclass(frozen=True, slots=True)
class Heights:
    """New heights of some cells, arrays (n,).

    Attributes:
        slot: slot of each cell in the map's memory, without duplicates.
        height: [m] in odom.
        variance: [m^2].
        distance: distance of each cell from the robot [m], the lever arm of a yaw error.
        below, above: distance of the lowest and highest sample from the height, 0 or more [m].
        steepness: tan^2 of the slope.
    """

    slot: Index
    height: Float
    variance: Float
    distance: Float
    below: Float | float = 0.0
    above: Float | float = 0.0
    steepness: Float | float = 0.0


def drift_variance(cells: OdomCells, slot: Index, drift: OdometryDrift, distance: Float) -> Float:
    """Increase of the height variance since cells were last seen [m^2]: drift in z, and sideways drift on slopes.

    Args:
        cells: memory of the map.
        slot: (n,) slots of the cells.
        drift: present drift of the odometry.
        distance: (n,) distances of the cells from the robot [m], the lever arm of a yaw error.
    """
    memory = cells.memory
    rise, shift, turn = (
        np.maximum(getattr(drift, name) - memory[name][slot], 0.0) for name in ("rise", "shift", "turn")
    )
    return np.asarray(rise + memory["steepness"][slot] * (shift + turn * distance**2))


def fuse_heights(cells: OdomCells, new: Heights, now: MapPause, *, is_scan: bool = True) -> Mask:
    """Fuse heights into the memory: a Kalman filter per cell with a gate on the innovation.

    An unknown cell takes the new height. A known cell is updated if the innovation is within GATE_SIGMAS; otherwise it
    keeps its height and is in conflict. While in conflict, each new height is compared with the one before it, and two
    in a row that agree replace the old height.

    Args:
        cells: memory of the map, changed in place.
        new: heights to fuse.
        now: present pause.
        is_scan: the heights come from a scan, not from a foot or from the gait.

    Returns:
        (n,) mask of the accepted heights.
    """
    memory, slot = cells.memory, new.slot
    grown = drift_variance(cells, slot, now.drift, new.distance)
    height, variance = memory["height"][slot], memory["variance"][slot] + grown
    below, above = memory["below"][slot], memory["above"][slot]
    other, other_variance = memory["other"][slot], memory["other_variance"][slot] + grown
    was_known, disputed = np.isfinite(height), memory["conflict"][slot]

    def agrees(value: Float, its_variance: Float) -> Mask:
        with np.errstate(invalid="ignore"):
            return np.asarray(np.abs(new.height - value) <= GATE_SIGMAS * np.sqrt(its_variance + new.variance))

    confirmed = was_known & ~disputed & agrees(height, variance)
    settled = was_known & disputed & agrees(other, other_variance)
    rejected = was_known & ~confirmed & ~settled
    prior = np.where(settled, other, height)
    prior_variance = np.where(settled, other_variance, variance)
    with np.errstate(divide="ignore", invalid="ignore"):
        gain = np.where(prior_variance > 0, prior_variance / (prior_variance + new.variance), 0.0)
    corrected = prior + gain * (new.height - prior)
    accepted = confirmed | settled

    memory["height"][slot] = np.where(accepted, corrected, np.where(was_known, height, new.height))
    memory["variance"][slot] = np.where(
        accepted, (1 - gain) * prior_variance, np.where(was_known, variance, new.variance)
    )
    # While observations disagree, the extremes of both are kept.
    below_both = np.maximum(below, height - (new.height - new.below))
    above_both = np.maximum(above, new.height + new.above - height)
    memory["below"][slot] = np.where(confirmed, np.maximum(below, new.below), np.where(rejected, below_both, new.below))
    memory["above"][slot] = np.where(confirmed, np.maximum(above, new.above), np.where(rejected, above_both, new.above))
    memory["steepness"][slot] = np.where(rejected, np.maximum(memory["steepness"][slot], new.steepness), new.steepness)
    memory["conflict"][slot] = rejected
    memory["other"][slot] = np.where(rejected, new.height, np.nan)
    memory["other_variance"][slot] = np.where(rejected, new.variance, 0.0)
    memory["cause"][slot] = 0
    memory["pause"][slot], memory["stamp"][slot] = now.pause, now.stamp
    for name in ("rise", "shift", "turn"):
        memory[name][slot] = getattr(now.drift, name)
    if is_scan:
        looks = memory["looks"][slot]
        memory["looks"][slot] = np.where(was_known, np.minimum(looks, 254) + 1, 1)
    return np.asarray(~rejected)


def forget_heights(cells: OdomCells, slot: Index, cause: Flags) -> None:
    """Set cells that were observed without a return to unknown."""
    memory = cells.memory
    for name in ("height", "other"):
        memory[name][slot] = np.nan
    for name in ("variance", "below", "above", "steepness", "other_variance", "looks", "conflict"):
        memory[name][slot] = 0
    memory["cause"][slot] = cause


@dataclass(frozen=True, slots=True)
class Observation:
    """Scan resampled to the cells of the map.

    Attributes:
        heights: cells with a height.
        empty: slots of cells that were observed without a usable return.
        empty_cause: flags of these cells.
        unseen: slots of cells of the area that were not observed.
        unseen_cause: flags of these cells.
    """

    heights: Heights
    empty: Index
    empty_cause: Flags
    unseen: Index
    unseen_cause: Flags


def observe(cells: OdomCells, terrain: TerrainGrid, transform_footprint_to_odom: Float) -> Observation:
    """Resample a scan to the cells of the map that its area covers.

    Values are those of the nearest cell of the scan. A map cell that touches a scan cell without a usable return counts
    as empty, because part of it was observed without a return.

    Args:
        cells: memory of the map, with its window around the robot.
        terrain: grid of the scan alone.
        transform_footprint_to_odom: (4, 4).
    """
    grid, transform = terrain.geometry, transform_footprint_to_odom
    resolution = cells.resolution
    (x0, y0), (ny, nx) = grid.origin, grid.shape
    corners = np.array([(x0 + i * nx * grid.resolution, y0 + j * ny * grid.resolution) for i in (0, 1) for j in (0, 1)])
    corners_in_odom = corners @ transform[:2, :2].T + transform[:2, 3]
    (low_x, low_y), (high_x, high_y) = corners_in_odom.min(axis=0), corners_in_odom.max(axis=0)
    cy, cx = cells.cells_between((low_x, low_y), (high_x, high_y))
    slot = cells.slots(cy, cx)
    # Offsets of the cell centres from the footprint, along the axes of odom, then of the footprint.
    offset_x, offset_y = (cx + 0.5) * resolution - transform[0, 3], (cy + 0.5) * resolution - transform[1, 3]
    (xx, xy), (yx, yy) = np.linalg.inv(transform[:2, :2])
    x, y = xx * offset_x + xy * offset_y, yx * offset_x + yy * offset_y
    if np.any(transform[:2, 2]):
        # If the z axes of footprint and odom differ, the height of a cell shifts it horizontally.
        height = np.nan_to_num(np.asarray(terrain.height_at(x, y), dtype=np.float64))
        offset_x, offset_y = offset_x - height * transform[0, 2], offset_y - height * transform[1, 2]
        x, y = xx * offset_x + xy * offset_y, yx * offset_x + yy * offset_y
    iy, ix = grid.indices(x, y)
    used = np.flatnonzero(grid.contains(iy, ix) & (slot >= 0))
    x, y, iy, ix, slot = x[used], y[used], iy[used], ix[used], slot[used]

    hazard = scan_flags(terrain)
    own = hazard[iy, ix] & UNKNOWN_MASK
    no_return = _touched_flags(hazard, grid, x, y, transform) & LOOKED_AT
    is_empty = no_return != 0
    is_seen = (own == 0) & ~is_empty
    is_unseen = (own != 0) & ~is_empty

    jy, jx = iy[is_seen], ix[is_seen]
    layers = {name: terrain.layers[name][jy, jx].astype(np.float64) for name in SEEN_LAYERS}
    height = layers["elevation"]
    relief = layers["elevation_max"] - layers["elevation_min"]
    steepness = np.tan(np.nan_to_num(layers["slope"])) ** 2
    at_x, at_y = x[is_seen], y[is_seen]
    variance = (
        layers["variance"]
        + LOOK_SIGMA_M**2
        + tilt_variance(terrain, at_x, at_y)
        # The nearest cell is up to half a cell away; within a cell the ground has relief.
        + steepness * resolution**2 / 12
        + relief**2 / 12
    )
    in_odom = transform[2, 0] * at_x + transform[2, 1] * at_y + transform[2, 2] * height + transform[2, 3]
    heights = Heights(
        slot=slot[is_seen],
        height=in_odom,
        variance=variance,
        distance=np.sqrt(at_x * at_x + at_y * at_y),
        below=np.maximum(height - layers["elevation_min"], 0.0),
        above=np.maximum(layers["elevation_max"] - height, 0.0),
        steepness=steepness,
    )
    return Observation(
        heights=heights,
        empty=slot[is_empty],
        empty_cause=no_return[is_empty],
        unseen=slot[is_unseen],
        unseen_cause=own[is_unseen],
    )


def _touched_flags(hazard: Flags, grid: GridGeometry, x: Float, y: Float, transform: Float) -> Flags:
    """Combined flags of the scan cells that each map cell touches; x and y (n,) are centres on the scan's grid."""
    if not x.size:
        return np.empty(0, np.uint16)
    half = 0.5 * grid.resolution * (abs(transform[0, 0]) + abs(transform[1, 0]))
    squares = Squares.of(grid, x, y, half)
    (iy, ix), (ny, nx) = squares.first, squares.shape
    # Padding of one cell, for map cells that reach over the edge.
    return squares.joined(np.pad(hazard, 1)[iy + 1 : iy + 1 + ny, ix + 1 : ix + 1 + nx], np.bitwise_or)


def scan_flags(terrain: TerrainGrid) -> Flags:
    """Flags of a scan's cells; unknown cells of a fired stripe whose frame was lost are also DROPOUT.

    Raises:
        InvalidInput: `lost_cells` of the metadata is not a list of runs of cells on this grid.
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


def tilt_variance(terrain: TerrainGrid, x: Float, y: Float) -> Float:
    """Variance of heights in base_footprint due to the tilt of the stance pose [m^2]; 0 if its covariance is unknown.

    A rotation (rx, ry) about the footprint's axes raises the point (x, y) by rx y - ry x.
    """
    terrain.record.check("pose_covariance")
    covariance = terrain.record.pose_covariance
    if covariance is None:
        return np.zeros(np.shape(x))
    tilt = covariance[3:5, 3:5]
    return np.asarray(tilt[0, 0] * y**2 + tilt[1, 1] * x**2 - 2 * tilt[0, 1] * x * y)
