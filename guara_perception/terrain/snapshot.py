"""A view of the rolling map in base_footprint: nearest cell for values, union of the flags of all cells touched."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from guara_perception.settings import Settings
from guara_perception.terrain.assess import assess_layers
from guara_perception.terrain.fuse_heights import Drift, drift_variance
from guara_perception.terrain.geometry import GridGeometry
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.hazard import UNKNOWN_MASK, Hazard
from guara_perception.terrain.look import tilt_variance
from guara_perception.terrain.odom_cells import Index, OdomCells
from guara_perception.terrain.touched import touched_rows_and_columns

Float = npt.NDArray[np.float64]

NEVER_SEEN_AGE = 255


@dataclass(frozen=True, slots=True)
class Moment:
    """The pause at which the map is looked at.

    Attributes:
        pause: its number.
        stamp: [ns since the epoch].
        drift: of the odometry.
        transform_footprint_to_odom: (4, 4).
    """

    pause: int
    stamp: int
    drift: Drift
    transform_footprint_to_odom: Float


def snapshot_layers(
    cells: OdomCells, geometry: GridGeometry, terrain: TerrainGrid, now: Moment, settings: Settings
) -> dict[str, npt.NDArray[Any]]:
    """All layers of the `map` extent.

    A cell whose square touches an unknown cell of the map is unknown, with the causes of all of them; lowest and
    highest samples are those of all cells touched, so that no narrow bump slips between the nearest ones.
    """
    x, y = geometry.centres()
    x, y = np.tile(x, y.size), np.repeat(y, x.size)
    transform = now.transform_footprint_to_odom
    row = transform[2]
    drop = row[0] * x + row[1] * y + row[3]
    memory = cells.memory
    in_odom = np.column_stack((x, y)) @ transform[:2, :2].T + transform[:2, 3]
    if np.any(transform[:2, 2]):
        # Where the two verticals differ a cell's height moves it sideways.
        place = cells.places(*cells.cells_of(in_odom[:, 0], in_odom[:, 1]))
        height = np.nan_to_num(np.where(place >= 0, memory["height"][place] - drop, 0.0) / row[2])
        in_odom = in_odom + height[:, None] * transform[:2, 2]
    half = 0.5 * geometry.resolution * (abs(transform[0, 0]) + abs(transform[1, 0]))
    squares = _Squares.of(cells, in_odom[:, 0], in_odom[:, 1], half)
    flags = squares.joined(_flags(cells, squares, now, settings), np.bitwise_or)

    known = np.flatnonzero((flags & UNKNOWN_MASK) == 0)
    x, y, drop = x[known], y[known], drop[known]
    heights = cells.patch("height", squares.first, squares.shape, np.nan)
    low = heights - cells.patch("below", squares.first, squares.shape, 0.0)
    high = heights + cells.patch("above", squares.first, squares.shape, 0.0)
    place = cells.places(squares.centre[0][known], squares.centre[1][known])
    pauses = np.clip(now.pause - memory["pause"][place], 0, NEVER_SEEN_AGE - 1)
    variance = memory["variance"][place] + drift_variance(cells, place, now.drift, np.hypot(x, y))
    # What was seen at this very pause shares its tilt; older heights do not.
    variance += np.where(pauses > 0, tilt_variance(terrain, x, y), 0.0)

    def shaped(values: npt.NDArray[Any], unknown: Any) -> npt.NDArray[Any]:
        layer = np.full(geometry.size, unknown, dtype=values.dtype)
        layer[known] = values
        return layer.reshape(geometry.shape)

    layers = assess_layers(
        shaped((memory["height"][place] - drop) / row[2], np.nan),
        shaped(variance, np.nan),
        shaped((squares.joined(low, np.fmin, known) - drop) / row[2], np.nan),
        shaped((squares.joined(high, np.fmax, known) - drop) / row[2], np.nan),
        flags.reshape(geometry.shape),
        geometry.resolution,
        settings.limits,
    )
    layers["age"] = shaped(pauses.astype(np.uint8), NEVER_SEEN_AGE)
    layers["looks"] = shaped(memory["looks"][place], 0)
    return layers


def _flags(cells: OdomCells, squares: _Squares, now: Moment, settings: Settings) -> npt.NDArray[np.uint16]:
    """Why each cell of the memory is unknown, and whether it is in conflict or stale; UNSCANNED outside."""

    def patch(name: str, outside: Any) -> npt.NDArray[Any]:
        return cells.patch(name, squares.first, squares.shape, outside)

    flags = patch("cause", np.uint16(Hazard.UNSCANNED))
    flags[patch("conflict", False)] |= np.uint16(Hazard.CONFLICT)
    # Older than its validity, in pauses or in seconds.
    old = now.pause - patch("pause", now.pause) > settings.validity_pauses
    old |= now.stamp - patch("stamp", now.stamp) > settings.validity_seconds * 1e9
    flags[old & np.isfinite(patch("height", np.nan))] |= np.uint16(Hazard.STALE)
    return flags


@dataclass(frozen=True, slots=True)
class _Squares:
    """The cells of a grid, laid over the memory: which of its cells each of them touches.

    Attributes:
        first: (cy, cx) of the lowest cell of the memory that any touches.
        shape: rows and columns from there to the highest one.
        lowest: place of the lowest cell that each touches, in arrays of that shape.
        rows, columns: how many more it touches each way, 0 ... 2.
        centre: cells (cy, cx) under the centres.
    """

    first: tuple[int, int]
    shape: tuple[int, int]
    lowest: Index
    rows: Index
    columns: Index
    centre: tuple[Index, Index]

    @classmethod
    def of(cls, cells: OdomCells, x: Float, y: Float, half: float) -> _Squares:
        """Upright squares of half edge `half` about points of `odom`."""
        (low_y, low_x), centre, (high_y, high_x) = touched_rows_and_columns(_Window(cells), x, y, half)
        first = int(low_y.min()), int(low_x.min())
        shape = int(high_y.max()) - first[0] + 1, int(high_x.max()) - first[1] + 1
        lowest = (low_y - first[0]) * shape[1] + low_x - first[1]
        return cls(first, shape, lowest, high_y - low_y, high_x - low_x, centre)

    def joined(self, layer: npt.NDArray[Any], join: np.ufunc, which: Index | None = None) -> npt.NDArray[Any]:
        """Values of an array of this shape, joined over all cells that each square touches.

        Args:
            layer: (rows, columns).
            join: of two values, in any order.
            which: squares asked for; None for all.
        """
        lowest, rows, columns = (a if which is None else a[which] for a in (self.lowest, self.rows, self.columns))
        most_columns = int(columns.max(initial=0))
        # Rolled in from the other side comes only what lies beyond the array, which no square touches.
        tables: list[npt.NDArray[Any]] = []
        for down in range(int(rows.max(initial=0)) + 1):
            tables.append(layer if not down else join(tables[-most_columns - 1], np.roll(layer, -down, axis=0)))
            base = tables[-1]
            for right in range(1, most_columns + 1):
                tables.append(join(tables[-1], np.roll(base, -right, axis=1)))
        table = np.stack(tables).reshape(-1)
        return table.take((rows * (most_columns + 1) + columns) * layer.size + lowest)


@dataclass(frozen=True, slots=True)
class _Window:
    """The cells of the memory as a grid to ask indices of."""

    cells: OdomCells

    def indices(self, x: Float, y: Float) -> tuple[Index, Index]:
        return self.cells.cells_of(x, y)
