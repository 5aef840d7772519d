"""The surface of one scan on the cells of a grid, kept up to date stripe by stripe."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from guara_perception.arrays import Flags
from guara_perception.ranging.groups import TOGETHER, in_groups
from guara_perception.ranging.stripe_points import StripePoints
from guara_perception.ranging.surface import Key, line_samples, surface_keys, surface_of
from guara_perception.terrain.assessment.raster import (
    CellSamples,
    Raster,
    cells_of,
    merge,
    rasterise_swaths,
    without_cells,
)
from guara_perception.terrain.layers.geometry import GridGeometry
from guara_perception.terrain.layers.hazard import Hazard


class SurfaceRaster:
    """Takes the stripes of a scan in any order and rasterises each swath as soon as nothing can change it any more."""

    def __init__(self, geometry: GridGeometry, pattern: range, join_height: float) -> None:
        """Start empty.

        Args:
            geometry: the cells.
            pattern: indices of the stripes of the scan's mode.
            join_height: largest height difference of one surface [m].
        """
        self._geometry = geometry
        self._pattern = pattern
        self._stripes: dict[int, StripePoints] = {}
        self._join_height = join_height
        self._final: dict[Key, CellSamples] = {}
        self._out_of_range = np.zeros(geometry.shape, dtype=bool)
        self._too_high = np.zeros(geometry.shape, dtype=bool)

    @property
    def stripes(self) -> dict[int, StripePoints]:
        """Points of the stripes added so far, by ascending index."""
        return dict(sorted(self._stripes.items()))

    def add(self, stripes: Mapping[int, StripePoints]) -> None:
        """Take stripes by index, one or several: faster, with the same result."""
        for group in in_groups(list(stripes)):
            self._stripes.update((index, stripes[index]) for index in group)
            self._mark_out_of_range(group)
            touched = {key for index in group for key in self._touched(index)}
            self._final.update(self._swaths(sorted(key for key in touched if self._is_settled(key))))

    def raster(self) -> Raster:
        """Heights of all that was added so far; a cell with a return above the height limits is not known.

        A return below them says only why a cell is unknown: from under a surface that was seen nothing can return, so
        there it is a stray reflection.
        """
        keys = surface_keys(self._stripes, self._pattern)
        swaths = self._final | self._swaths([key for key in keys if key not in self._final])
        merged = merge((swaths[key] for key in sorted(swaths)), self._geometry)
        return without_cells(merged, self._too_high)

    def marks(self) -> Flags:
        """Flags of returns that were seen in a cell and may not be used."""
        marks = np.where(self._out_of_range, np.uint16(Hazard.OUT_OF_RANGE), np.uint16(0))
        # Few of each stripe: those of all stripes in one go.
        doubtful = [stripe.doubtful.points for stripe in self._stripes.values() if stripe.doubtful.columns.size]
        if doubtful:
            cell, _ = cells_of(np.concatenate(doubtful), self._geometry)
            marks.ravel()[cell] |= np.uint16(Hazard.AMBIGUOUS)
        return marks

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
        first, second = key
        around = (first - self._pattern.step, second + self._pattern.step)
        return self._is_there(key) and all(i in self._stripes or i not in self._pattern for i in around)

    def _swaths(self, keys: list[Key]) -> dict[Key, CellSamples]:
        cell = self._geometry.resolution
        low = self._geometry.origin[1] - cell
        y_range = (low, low + (self._geometry.shape[0] + 2) * cell)
        swaths: dict[Key, CellSamples] = {}
        for group in in_groups(keys, 2 * TOGETHER):
            samples = surface_of(self._stripes, group, self._pattern, self._join_height, cell, y_range)
            swaths.update(zip(group, rasterise_swaths(samples, len(group), self._geometry), strict=True))
        return swaths

    def _mark_out_of_range(self, group: list[int]) -> None:
        """Mark the cells of returns from beyond the height limits, and those between two such returns."""
        beyond = [index for index in group if self._stripes[index].out_of_range.columns.size]
        if not beyond:
            return
        stride, cell = self._pattern.step, self._geometry.resolution
        firsts = {first for index in beyond for first in (index - stride, index)}
        # Between two stripes that both saw something too low or too high the ground is no better.
        ends = [(first, first + stride) for first in firsts if self._is_there((first, first + stride))]
        lines = [line_samples((self._stripes[i].out_of_range, self._stripes[j].out_of_range), cell) for i, j in ends]
        points = np.concatenate([*(self._stripes[index].out_of_range.points for index in beyond), *lines])
        cells, inside = cells_of(points, self._geometry)
        self._out_of_range.ravel()[cells] = True
        self._too_high.ravel()[cells[points[inside, 2] > 0]] = True
