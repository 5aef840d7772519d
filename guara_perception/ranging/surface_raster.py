"""Surface of one scan on the cells of a grid, updated stripe by stripe."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from operator import itemgetter

import numpy as np

from guara_perception.arrays import Flags, Float
from guara_perception.ranging.scan_geometry import TOGETHER, in_groups
from guara_perception.ranging.stripe_points import ColumnPoints, StripePoints
from guara_perception.ranging.surface import Key, sample_count, shares, surface_of
from guara_perception.terrain.assessment.raster import (
    CellSamples,
    Raster,
    cells_of,
    merge,
    rasterise_swaths,
    runs,
    without_cells,
)
from guara_perception.terrain.layers.geometry import GridGeometry
from guara_perception.terrain.layers.hazard import Hazard


class SurfaceRaster:
    """Raster of the stripes of a scan, added in any order; each swath is rasterised once no stripe can change it."""

    def __init__(
        self, geometry: GridGeometry, pattern: range, join_height: float, parted: Collection[Key] = ()
    ) -> None:
        """Start empty.

        Args:
            geometry: the cells.
            pattern: indices of the stripes of the scan's mode.
            join_height: largest height difference of one surface [m].
            parted: pairs of neighbouring stripes between which there is no surface.
        """
        self._parted = frozenset(parted)
        self._geometry = geometry
        self._pattern = pattern
        self._stripes: dict[int, StripePoints] = {}
        self._join_height = join_height
        # Columns and samples by swath.
        self._swaths: dict[Key, tuple[slice, CellSamples]] = {}
        # Swaths to be rasterised because a stripe that they depend on was added, and columns to be merged.
        self._to_make: set[Key] = set()
        self._to_merge = np.zeros(geometry.shape[1], dtype=bool)
        self._raster = merge((), geometry)
        self._out_of_range, self._too_high = (np.zeros(geometry.shape, dtype=bool) for _ in range(2))

    @property
    def stripes(self) -> dict[int, StripePoints]:
        """Points of the stripes added so far, by ascending index."""
        return dict(sorted(self._stripes.items()))

    def add(self, stripes: Mapping[int, StripePoints]) -> None:
        """Add stripes by index; several in one call are faster, with the same result."""
        for group in in_groups(list(stripes)):
            self._stripes.update((index, stripes[index]) for index in group)
            self._to_make.update(key for index in group for key in self._touched(index) if self._is_there(key))
            self._make([key for key in self._to_make if self._is_settled(key)])
            self._mark_out_of_range(group)

    def raster(self) -> Raster:
        """Heights of all stripes added so far; a cell with a return above the height limits is unknown.

        A return below them only marks the cause of an unknown cell: below a surface that was seen it is a stray
        reflection. Only the columns of swaths made since the last call are merged again.
        """
        self._make(list(self._to_make))
        for columns in runs(self._to_merge):
            there = [
                swath
                for _, (own, swath) in sorted(self._swaths.items(), key=itemgetter(0))
                if own.start < columns.stop and columns.start < own.stop
            ]
            self._raster = self._raster.with_columns(columns, merge(there, self._geometry, columns))
        self._to_merge.fill(False)
        return without_cells(self._raster, self._too_high)

    def marks(self) -> Flags:
        """Flags of the cells with unusable returns."""
        flags = self._out_of_range * np.uint16(Hazard.OUT_OF_RANGE)
        doubtful = np.concatenate([np.empty((0, 3)), *(each.doubtful.points for each in self._stripes.values())])
        flags.ravel()[cells_of(doubtful, self._geometry)[0]] |= np.uint16(Hazard.AMBIGUOUS)
        return flags

    def _touched(self, index: int) -> list[Key]:
        """Stripes and pairs whose surface depends on a stripe."""
        stride = self._pattern.step
        return [
            *((k, k) for k in (index - stride, index, index + stride)),
            *((k, k + stride) for k in (index - 2 * stride, index - stride, index, index + stride)),
        ]

    def _is_there(self, key: Key) -> bool:
        return key[0] in self._stripes and key[1] in self._stripes

    def _is_settled(self, key: Key) -> bool:
        """Test that no later stripe can change a swath."""
        first, second = key
        around = (first - self._pattern.step, second + self._pattern.step)
        return all(i in self._stripes or i not in self._pattern for i in around)

    def _make(self, keys: list[Key]) -> None:
        """Rasterise swaths by the stripes that are there."""
        cell = self._geometry.resolution
        low = self._geometry.origin[1] - cell
        y_range = (low, low + (self._geometry.shape[0] + 2) * cell)
        for group in in_groups(sorted(keys), 2 * TOGETHER):
            samples = surface_of(self._stripes, group, self._pattern, self._join_height, cell, y_range, self._parted)
            found = rasterise_swaths(samples, len(group), self._geometry)
            for key, swath in zip(group, found, strict=True):
                columns = swath.columns(self._geometry)
                before, _ = self._swaths.get(key, (columns, swath))
                self._to_merge[before] = self._to_merge[columns] = True
                self._swaths[key] = columns, swath
        self._to_make.difference_update(keys)

    def _mark_out_of_range(self, group: list[int]) -> None:
        """Mark the cells of returns from beyond the height limits, and those between two such returns."""
        beyond = [index for index in group if self._stripes[index].out_of_range.columns.size]
        if not beyond:
            return
        stride, cell = self._pattern.step, self._geometry.resolution
        firsts = {first for index in beyond for first in (index - stride, index)}
        # The ground between two stripes that are both out of range there is out of range too.
        ends = [(first, first + stride) for first in firsts if self._is_there((first, first + stride))]
        lines = [line_samples((self._stripes[i].out_of_range, self._stripes[j].out_of_range), cell) for i, j in ends]
        points = np.concatenate([*(self._stripes[index].out_of_range.points for index in beyond), *lines])
        cells, inside = cells_of(points, self._geometry)
        self._out_of_range.ravel()[cells] = True
        self._too_high.ravel()[cells[points[inside, 2] > 0]] = True


def line_samples(ends: tuple[ColumnPoints, ColumnPoints], resolution: float) -> Float:
    """Points (n, 3) along the lines between two stripes, in all columns in which both have a point."""
    _, in_first, in_second = np.intersect1d(ends[0].columns, ends[1].columns, assume_unique=True, return_indices=True)
    if not in_first.size:
        return np.empty((0, 3))
    first = ends[0].points[in_first]
    difference = ends[1].points[in_second] - first
    (n,) = sample_count(difference.T[:, None], np.ones((1, len(difference)), dtype=bool), resolution)
    return np.asarray((first + shares(n)[..., None] * difference).reshape(-1, 3))
