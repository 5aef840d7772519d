"""The surface of one scan on the cells of a grid, kept up to date stripe by stripe."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from guara_perception.ranging.scan_surface import Links, pair_surface, stripe_surface
from guara_perception.ranging.stripe_points import StripePoints
from guara_perception.ranging.surface import Surface, line_samples
from guara_perception.terrain.geometry import GridGeometry
from guara_perception.terrain.hazard import Hazard
from guara_perception.terrain.raster import CellSamples, Raster, cells_of, merge, rasterise_parts, without_cells

Flags = npt.NDArray[np.uint16]
Key = tuple[int, int]


class SurfaceRaster:
    """Takes the stripes of a scan in any order and rasterises each part as soon as nothing can change it any more."""

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
        self._links = Links(self._stripes, pattern, join_height)
        self._final: dict[Key, CellSamples] = {}
        self._marks: Flags = np.zeros(geometry.shape, dtype=np.uint16)
        self._too_high = np.zeros(geometry.shape, dtype=bool)

    @property
    def stripes(self) -> dict[int, StripePoints]:
        """Points of the stripes added so far, by ascending index."""
        return dict(sorted(self._stripes.items()))

    def add(self, index: int, stripe: StripePoints) -> None:
        """Take one stripe."""
        self._stripes[index] = stripe
        spacing = self._pattern.step
        self._mark(stripe.out_of_range.points, Hazard.OUT_OF_RANGE)
        self._mark(stripe.doubtful.points, Hazard.AMBIGUOUS)
        for first, second in ((index - spacing, index), (index, index + spacing)):
            if first in self._stripes and second in self._stripes:
                # Between two stripes that both saw something too low or too high the ground is no better.
                ends = (self._stripes[first].out_of_range, self._stripes[second].out_of_range)
                self._mark(line_samples(ends, self._geometry.resolution), Hazard.OUT_OF_RANGE)
        self._final.update(self._parts([key for key in self._touched(index) if self._is_settled(key)]))

    def raster(self) -> Raster:
        """Heights of all that was added so far; a cell with a return above the height gates is not known.

        A return below them says only why a cell is unknown: from under a surface that was seen nothing can return, so
        there it is a stray reflection.
        """
        step = self._pattern.step
        keys = [key for k in self._stripes for key in ((k, k), (k, k + step)) if self._is_there(key)]
        parts = self._final | self._parts([key for key in keys if key not in self._final])
        merged = merge((parts[key] for key in sorted(parts)), self._geometry)
        return without_cells(merged, self._too_high)

    def marks(self) -> Flags:
        """Flags of returns that were seen in a cell and may not be used."""
        return self._marks.copy()

    def _touched(self, index: int) -> list[Key]:
        """Stripes and pairs whose surface depends on a stripe."""
        s = self._pattern.step
        return [
            *((k, k) for k in (index - s, index, index + s)),
            *((k, k + s) for k in (index - 2 * s, index - s, index, index + s)),
        ]

    def _is_there(self, key: Key) -> bool:
        return key[0] in self._stripes and key[1] in self._stripes

    def _is_settled(self, key: Key) -> bool:
        first, second = key
        around = (first - self._pattern.step, second + self._pattern.step)
        return self._is_there(key) and all(i in self._stripes or i not in self._pattern for i in around)

    def _parts(self, keys: list[Key]) -> dict[Key, CellSamples]:
        if not keys:
            return {}
        surfaces = [self._surface(*key) for key in keys]
        parts = rasterise_parts([(surface.points, surface.variance) for surface in surfaces], self._geometry)
        return dict(zip(keys, parts, strict=True))

    def _surface(self, first: int, second: int) -> Surface:
        if first == second:
            return stripe_surface(self._stripes, first, self._links)
        wanted = ~self._off_grid(self._stripes[first], self._stripes[second])
        return pair_surface(self._stripes, first, self._links, self._geometry.resolution, wanted)

    def _off_grid(self, first: StripePoints, second: StripePoints) -> npt.NDArray[np.bool_]:
        """Columns whose two points both lie beyond the same side of the grid, and so all between them."""
        margin = self._geometry.resolution
        low = self._geometry.origin[1] - margin
        high = low + self._geometry.shape[0] * self._geometry.resolution + 2 * margin
        y = first.points[:, 1], second.points[:, 1]
        return np.asarray((np.maximum(*y) < low) | (np.minimum(*y) > high))

    def _mark(self, points: npt.NDArray[np.float64], flag: Hazard) -> None:
        if not len(points):
            return
        cell, inside = cells_of(points, self._geometry)
        self._marks.ravel()[cell] |= np.uint16(flag)
        if flag is Hazard.OUT_OF_RANGE:
            self._too_high.ravel()[cell[points[inside, 2] > 0]] = True
