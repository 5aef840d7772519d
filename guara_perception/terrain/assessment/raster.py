"""Rasters: samples summed per cell, merged into heights and pooled into coarser cells."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from guara_perception.arrays import Array, Flags, Float, Float32, Index, Mask
from guara_perception.terrain.layers.geometry import GridGeometry

# Samples farther than this below the highest sample of a cell belong to another surface; a foot meets the top one.
TOP_LAYER_M = 0.004
# Tolerance for rounding errors, as in `GridGeometry.indices` [cells].
ROUNDING = 1e-6


@dataclass(frozen=True, slots=True)
class CellSamples:
    """Samples of one swath, summed per cell, in arrays (n,) with one entry per cell.

    Attributes:
        cell: int32 index ix * (ny + 2) + iy, ascending, with column and row counted from 1; a ring of cells around the
            grid collects the samples outside it.
        total, count: float64 sum and float32 number of the heights in the top layer of the cell.
        variance_total: float32 sum of the variances of these heights.
        low, high: float32 lowest and highest height of all samples.
    """

    cell: npt.NDArray[np.int32]
    total: Float
    count: Float32
    variance_total: Float32
    low: Float32
    high: Float32

    def columns(self, geometry: GridGeometry) -> slice:
        """Range of grid columns that contains all samples on the grid."""
        if not self.cell.size:
            return slice(0, 0)
        first, last = (int(cell) // (geometry.shape[0] + 2) - 1 for cell in (self.cell[0], self.cell[-1]))
        return slice(max(first, 0), max(last + 1, 0))


NO_SAMPLES = CellSamples(np.empty(0, np.int32), np.empty(0), *(np.empty(0, np.float32) for _ in range(4)))


@dataclass(frozen=True, slots=True)
class SurfaceSamples:
    """Samples of several swaths, in runs that each belong to one swath.

    A swath is the surface of one stripe, or the surface between two neighbouring stripes.

    Attributes:
        points: (3, n) points in base_footprint, coordinate by coordinate; NaN samples are ignored.
        variance: (n,) variance of the heights [m^2].
        runs: (swath, number of samples) of each run, with at least one sample per run and n in all. A swath may have
            any number of runs.
    """

    points: Float
    variance: Float
    runs: Sequence[tuple[int, int]]


@dataclass(frozen=True, slots=True)
class Raster:
    """Heights of a grid, all (ny, nx) float64, NaN where no sample fell.

    Attributes:
        elevation: mean height of the top layer of each cell [m].
        variance: mean local variance of the samples in that layer [m^2], an upper bound of the variance of their mean.
        low, high: lowest and highest sample [m].
    """

    elevation: Float
    variance: Float
    low: Float
    high: Float

    @property
    def layers(self) -> tuple[Float, Float, Float, Float]:
        """The four layers in the order of the attributes."""
        return self.elevation, self.variance, self.low, self.high

    def window(self, cells: tuple[slice, slice]) -> Raster:
        """Part of the raster with the given ranges of rows and columns."""
        return Raster(*(np.ascontiguousarray(layer[cells]) for layer in self.layers))

    def with_columns(self, columns: slice, part: Raster) -> Raster:
        """Copy with some columns replaced by those of `part`."""
        layers = [layer.copy() for layer in self.layers]
        for layer, values in zip(layers, part.layers, strict=True):
            layer[:, columns] = values
        return Raster(*layers)


def rasterise(points: Float, variance: Float, geometry: GridGeometry) -> CellSamples:
    """Sum the samples of the top layer of each cell.

    Args:
        points: (n, 3) in base_footprint; NaN points are ignored.
        variance: (n,) variance of the heights [m^2].
        geometry: the grid.
    """
    runs = [(0, len(points))] if len(points) else []
    return rasterise_swaths(SurfaceSamples(np.asarray(points.T, np.float64), variance, runs), 1, geometry)[0]


def rasterise_swaths(samples: SurfaceSamples, count: int, geometry: GridGeometry) -> list[CellSamples]:
    """Rasterise `count` independent swaths at once.

    The work array spans the columns of all swaths, so the swaths should be neighbours.
    """
    if not samples.runs:
        return [NO_SAMPLES] * count
    # Imported here, because guara-client contains this module but not the kernel.
    from guara_perception.stripes.kernel.library import address, addresses, kernel

    points, variance = (np.ascontiguousarray(values, np.float64) for values in (samples.points, samples.variance))
    cell, columns = _cells(points, geometry)
    # Cells of the columns that any swath touches. A swath fills at most as many cells as it has samples.
    first, end = (int(column) * (geometry.shape[0] + 2) for column in (columns[0], columns[1] + 1))
    span, most = end - first, min(cell.size, count * (end - first))
    work, sums, cells, bounds = (
        np.empty((5, span)),
        np.empty((5, most)),
        np.empty(most, np.int32),
        np.empty(count, np.int64),
    )
    runs = np.ascontiguousarray(np.array(samples.runs, np.int64).T)
    given = *addresses(cell, points[2], variance), most, address(runs), runs.shape[1], count, first, span
    kernel().sum_cells(*given, *addresses(work, sums, cells, bounds))
    used = int(bounds[-1])
    total, cells = sums[0, :used].copy(), cells[:used].copy()
    singles = [layer[:used].astype(np.float32) for layer in sums[1:]]
    return [
        CellSamples(cells[begin:end], total[begin:end], *(layer[begin:end] for layer in singles))
        for begin, end in itertools.pairwise([0, *bounds.tolist()])
    ]


def _cells(points: Float, geometry: GridGeometry) -> tuple[npt.NDArray[np.int32], Index]:
    """Cell (n,) of each point (3, n), numbered as in `CellSamples`; and the first and last column with points.

    Cells are the same as in `GridGeometry.indices`. Points that are unknown or outside the grid are assigned to the
    ring of cells around it.
    """
    from guara_perception.stripes.kernel.library import address, addresses, kernel

    n, (ny, nx) = points.shape[1], geometry.shape
    offset = np.array([1 + ROUNDING - origin / geometry.resolution for origin in geometry.origin])
    cell, columns = np.empty(n, np.int32), np.empty(2, np.int64)
    place = 1 / geometry.resolution, address(offset), nx, ny
    kernel().cells_of_samples(address(points), n, *place, *addresses(cell, columns))
    return cell, columns


def cells_of(points: Float, geometry: GridGeometry) -> tuple[Index, Mask]:
    """Flat cells iy * nx + ix (m,) of the known points (n, 3) on the grid, and the mask of these points."""
    ny, nx = geometry.shape
    ix, iy = np.divmod(_cells(np.ascontiguousarray(points.T, np.float64), geometry)[0], ny + 2)
    inside = np.asarray((ix > 0) & (ix <= nx) & (iy > 0) & (iy <= ny))
    return (iy[inside] - 1).astype(np.int64) * nx + (ix[inside] - 1), inside


def merge(swaths: Iterable[CellSamples], geometry: GridGeometry, columns: slice | None = None) -> Raster:
    """Merge the swaths of all stripes and pairs into the heights of a grid.

    Args:
        swaths: swaths in a fixed order, which determines the last bit of the sums.
        geometry: the grid.
        columns: columns of the grid to compute; None = all.
    """
    rows = geometry.shape[0] + 2
    first, end, _ = (columns or slice(None)).indices(geometry.shape[1])
    number = end - first
    swaths = [swath for swath in swaths if swath.cell.size]
    if not swaths:
        return Raster(*[np.broadcast_to(np.nan, (geometry.shape[0], number))] * 4)
    # Imported here, because guara-client contains this module but not the kernel.
    from guara_perception.stripes.kernel.library import addresses, kernel

    cell, *sums = (np.concatenate([getattr(swath, name) for swath in swaths]) for name in CellSamples.__slots__)
    size = (number + 2) * rows
    work, ends, raster = np.empty((3, size)), np.empty((2, size), np.float32), np.empty((4, rows - 2, number))
    kernel().merge_cells(*addresses(cell, *sums), cell.size, first, rows - 2, number, *addresses(work, ends, raster))
    return Raster(*raster)


def without_cells(raster: Raster, cells: Mask) -> Raster:
    """Copy with some cells unknown."""
    if not cells.any():
        return raster
    return Raster(*(np.where(cells, np.nan, layer) for layer in raster.layers))


def pool(raster: Raster, factor: int) -> Raster:
    """Pool `factor` x `factor` cells; one unknown fine cell makes the coarse cell unknown."""
    if factor == 1:
        return raster
    return Raster(
        elevation=blocks(raster.elevation, factor).mean(axis=-1),
        variance=blocks(raster.variance, factor).mean(axis=-1),
        low=blocks(raster.low, factor).min(axis=-1),
        high=blocks(raster.high, factor).max(axis=-1),
    )


def pool_flags(flags: Flags, factor: int) -> Flags:
    """Flags of coarser cells: union of the flags of `factor` x `factor` fine cells."""
    if factor == 1:
        return flags
    return np.asarray(np.bitwise_or.reduce(blocks(flags, factor), axis=-1), dtype=np.uint16)


def blocks(layer: Array, factor: int) -> Array:
    """Values (ny, nx, factor^2) of the `factor` x `factor` fine cells of each coarser cell."""
    ny, nx = (n // factor for n in layer.shape)
    return layer.reshape(ny, factor, nx, factor).swapaxes(1, 2).reshape(ny, nx, -1)


def runs(cells: Mask) -> list[slice]:
    """Ranges of adjacent cells in a mask (n,) of a row or column, in order."""
    ends = np.flatnonzero(np.diff(cells, prepend=False, append=False))
    return [slice(first, end) for first, end in ends.reshape(-1, 2).tolist()]
