"""Layers of the rolling map in base_footprint: values of the nearest map cells, flags of all touched cells."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from guara_perception.arrays import Array, Codes, Flags, Float, Index
from guara_perception.settings import Settings
from guara_perception.terrain.assessment.assess import assess_layers
from guara_perception.terrain.assessment.disc import step_slope
from guara_perception.terrain.assessment.raster import Raster
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.layers.geometry import (
    LARGEST_DRIFT_CELLS,
    GridGeometry,
    Kernel,
    beyond_border,
    disc_kernel,
)
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK, Hazard
from guara_perception.terrain.map.fuse_heights import MapPause, drift_variance
from guara_perception.terrain.map.fuse_scan import pose_variance, resampling_variance
from guara_perception.terrain.map.odom_cells import OdomCells, Squares
from guara_perception.terrain.map.soft_ground import SoftFoothold, soft_cells

NEVER_SEEN_AGE = 255


def snapshot_layers(
    cells: OdomCells,
    geometry: GridGeometry,
    terrain: TerrainGrid,
    now: MapPause,
    settings: Settings,
    soft: tuple[SoftFoothold, ...] = (),
) -> dict[str, Array]:
    """Compute the layers of a grid of extent `map`, except `ceiling`.

    A sole must lie on the grid, but the discs of the tests also read known ground outside it. A grid cell that touches
    unknown cells of the map is unknown, with the causes of all of them. The lowest and highest samples of a known cell
    are those of all map cells that it touches, so that no narrow bump is missed.
    """
    inner, beyond = geometry, beyond_border(settings.limits.disc_radius / geometry.resolution)
    geometry = inner.widened(beyond)
    x, y = geometry.centres()
    transform = now.transform_footprint_to_odom
    row, memory = transform[2], cells.memory
    in_odom_x, in_odom_y = (
        np.add.outer(transform[axis, 1] * y, transform[axis, 0] * x + transform[axis, 3]).ravel() for axis in (0, 1)
    )
    x, y = np.tile(x, y.size), np.repeat(y, x.size)
    if np.any(transform[:2, 2]):
        # If the z axes of footprint and odom differ, the height of a cell shifts it horizontally.
        slot = cells.slots(*cells.indices(in_odom_x, in_odom_y))
        rise = memory["height"][slot] - (row[0] * x + row[1] * y + row[3])
        height = np.nan_to_num(np.where(slot >= 0, rise, 0.0) / row[2])
        in_odom_x += height * transform[0, 2]
        in_odom_y += height * transform[1, 2]
    half = 0.5 * geometry.resolution * (abs(transform[0, 0]) + abs(transform[1, 0]))
    squares = Squares.of(cells, in_odom_x, in_odom_y, half)
    own_flags = _flags(cells, squares, now, settings)
    heights = cells.patch("height", squares.first, squares.shape, np.nan)
    if soft:
        sole = float(np.hypot(settings.limits.sole_length, settings.limits.sole_width)) / 2
        own_flags[soft_cells(heights, squares.first, cells.resolution, soft, sole)] |= np.uint16(Hazard.SOFT)
    flags = squares.joined(own_flags, np.bitwise_or)

    known = np.flatnonzero((flags & UNKNOWN_MASK) == 0)
    x, y = x.take(known), y.take(known)
    drop = row[0] * x + row[1] * y + row[3]
    low = heights - cells.patch("below", squares.first, squares.shape, 0.0)
    high = heights + cells.patch("above", squares.first, squares.shape, 0.0)
    slot = cells.slots(*cells.indices(in_odom_x.take(known), in_odom_y.take(known)))
    pauses = np.clip(now.pause - memory["pause"].take(slot), 0, NEVER_SEEN_AGE - 1)
    # While observations disagree, lowest and highest samples include both, and the larger variance is used.
    variance = np.maximum(memory["variance"].take(slot), memory["other_variance"].take(slot))
    own = np.minimum(memory["local"].take(slot), variance)
    drifted_by = drift_variance(cells, slot, now.drift, np.sqrt(x * x + y * y))
    # The drift of a cell depends on this cell alone, so that the loss of other cells never makes it safe.
    aside = now.sideways.variances(memory["pause"].take(slot), in_odom_x.take(known), in_odom_y.take(known), transform)
    drifted = np.ceil(settings.limits.confidence * np.sqrt(aside) / geometry.resolution)
    # A cell whose drift exceeds the largest margin is treated like one that was seen too long ago.
    flags[known[(drifted > LARGEST_DRIFT_CELLS).any(axis=0)]] |= np.uint16(Hazard.STALE)
    drifted = np.minimum(drifted, LARGEST_DRIFT_CELLS).astype(np.intp)

    def shaped(values: Array, unknown: Any) -> Array:
        layer = np.full(geometry.size, unknown, dtype=values.dtype)
        layer[known] = values
        return layer.reshape(geometry.shape)

    looks, kernel = memory["looks"].take(slot), disc_kernel(settings.limits.disc_radius / geometry.resolution)
    looked = _Looks(
        shaped(variance - own, np.nan),
        shaped(memory["apart"].take(slot), np.nan),
        shaped(drifted_by, np.nan),
        shaped(pauses, 0),
        shaped(looks, 0),
    )
    unshared = looked.unshared(kernel)
    own += resampling_variance(memory["steepness"].take(slot), geometry.resolution, transform)
    local = shaped(own, np.nan) + unshared
    # The error of an IMU may be new at every pause or always the same, so the larger of the two variances is used.
    at_feet = pose_variance(terrain, np.zeros(1), np.zeros(1))
    tilted = own + pose_variance(terrain, x, y) - at_feet
    total = shaped(np.maximum(variance, tilted) + at_feet + drifted_by, np.nan)
    raster = Raster(
        shaped((memory["height"].take(slot) - drop) / row[2], np.nan),
        local,
        shaped((squares.joined(low, np.fmin, known) - drop) / row[2], np.nan),
        shaped((squares.joined(high, np.fmax, known) - drop) / row[2], np.nan),
    )
    drift = np.stack((shaped(drifted[1], 0), shaped(drifted[0], 0)), axis=-1)
    layers = assess_layers(
        raster,
        flags.reshape(geometry.shape),
        geometry.resolution,
        settings.limits,
        drift,
        shared=np.maximum(total - local, 0.0),
        slope_sigma=np.hypot(
            terrain.record.checked_attitude_sigma, step_slope(kernel) * np.sqrt(2 * unshared) / geometry.resolution
        ),
        beyond=beyond,
    )
    cut = np.s_[beyond:-beyond, beyond:-beyond]
    layers["age"] = shaped(pauses.astype(np.uint8), NEVER_SEEN_AGE)[cut]
    layers["looks"] = shaped(looks, 0)[cut]
    return layers


@dataclass(frozen=True, slots=True)
class _Looks:
    """Observations (looks) of cells at several pauses, (ny, nx) each.

    Attributes:
        variance: stated variance of heights due to errors common to all cells of a look [m^2]; NaN in unknown cells.
        apart: measured variance of one look, from the differences between looks and the heights before them [m^2].
        drift: variance of heights due to drift since the last look [m^2]; NaN in unknown cells.
        pauses: number of pauses since the last look.
        looks: number of looks.
    """

    variance: Float
    apart: Float
    drift: Float
    pauses: Index
    looks: Codes

    def unshared(self, kernel: Kernel) -> Float:
        """Half the variance of the difference between a height and those in its disc, due to looks not shared [m^2].

        The difference of two means of m and n looks, c of them common, has the variance of one look times
        1 / m + 1 / n - 2 c / (m n). All cells of a disc have the looks from the latest first one to the earliest last
        one in common; the largest difference is used. If there is a common look and a nearby cell was observed twice,
        the variance of one look is the measured one. Otherwise it is the stated one, and the difference of the drift
        is added. Ground that no scan saw has no looks in common with other ground.
        """
        n, ones = self._most(self.looks, kernel), np.ones(len(kernel))
        m = np.minimum(self._least(self.looks, kernel), n)
        common = np.maximum(self._least(self.pauses + self.looks, kernel) - self._most(self.pauses, kernel), 0)
        again = (self.looks > 1) & np.isfinite(self.variance)
        number, total = (
            cv2.sepFilter2D(np.where(again, each, 0.0), -1, ones, ones, borderType=cv2.BORDER_CONSTANT)
            for each in (1.0, self.apart)
        )
        measured = np.maximum(total / np.maximum(number, 1), 0.0)
        claimed = self._most(self.variance * self.looks, kernel)
        drift = self._most(self.drift, kernel) - self._least(self.drift, kernel)
        with np.errstate(divide="ignore", invalid="ignore"):
            pairs = [1 / i + 1 / j - 2 * np.minimum(common, m) / (i * j) for i, j in ((m, m), (m, n), (n, n))]
            share = np.maximum.reduce(pairs)
            found = np.where((number > 0) & (common > 0), measured * share, claimed * share + drift)
        return np.where(m > 0, found, self._most(self.variance, kernel)) / 2

    def _least(self, values: Array, kernel: Kernel) -> Float:
        """Least value of the known cells in the disc around each cell."""
        known = np.where(np.isfinite(self.variance), values.astype(np.float64), np.finfo(np.float64).max)
        return np.asarray(cv2.erode(known, kernel), np.float64)

    def _most(self, values: Array, kernel: Kernel) -> Float:
        """Largest value of the known cells in the disc around each cell."""
        known = np.where(np.isfinite(self.variance), values.astype(np.float64), 0.0)
        return np.asarray(cv2.dilate(known, kernel), np.float64)


def _flags(cells: OdomCells, squares: Squares, now: MapPause, settings: Settings) -> Flags:
    """Flags of the cells in memory: causes of unknown cells, CONFLICT, STALE; UNSCANNED outside the window."""

    def patch(name: str, outside: Any) -> Array:
        return cells.patch(name, squares.first, squares.shape, outside)

    flags = patch("cause", np.uint16(Hazard.UNSCANNED))
    flags[patch("conflict", False)] |= np.uint16(Hazard.CONFLICT)
    # Cells older than their validity, in pauses or in seconds.
    old = now.pause - patch("pause", now.pause) > settings.validity_pauses
    age = now.stamp - patch("stamp", now.stamp)
    # A stamp in the future is from another clock, so the age is unknown.
    old |= (age > settings.validity_seconds * 1e9) | (age < 0)
    flags[old & np.isfinite(patch("height", np.nan))] |= np.uint16(Hazard.STALE)
    return flags
