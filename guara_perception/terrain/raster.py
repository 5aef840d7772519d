"""Rasterises stripes: samples, and the lines between neighbouring stripes, into the cells of a grid."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from guara_perception.terrain.geometry import GridGeometry

Float = npt.NDArray[np.float64]
Single = npt.NDArray[np.float32]

# Samples this far below the highest of a cell belong to another surface: the top one is what a foot meets.
TOP_LAYER_M = 0.004
# Part of a cell by which `GridGeometry.indices` forgives rounding.
ROUNDING = 1e-6


@dataclass(frozen=True, slots=True)
class CellSamples:
    """Samples of one stripe or one pair, summed per cell; arrays of equal length, each cell once.

    Attributes:
        cell: int32 flat cell index iy * nx + ix.
        total, count: sum and number of the heights in the top layer of the cell, float64 and float32.
        variance_total: float32 sum of their variances.
        low, high: float32 lowest and highest height of any sample.
    """

    cell: npt.NDArray[np.int32]
    total: Float
    count: Single
    variance_total: Single
    low: Single
    high: Single


NO_SAMPLES = CellSamples(np.empty(0, np.int32), np.empty(0), *(np.empty(0, np.float32) for _ in range(4)))


@dataclass(frozen=True, slots=True)
class Raster:
    """A grid of heights: all (ny, nx) float64, NaN (count 0) where no sample fell."""

    elevation: Float
    variance: Float
    low: Float
    high: Float
    count: Float


def rasterise(points: Float, variance: Float, geometry: GridGeometry) -> CellSamples:
    """Sum samples per cell, the top layer of each cell apart from what lies below it.

    Args:
        points: (n, 3) in base_footprint; NaN points are left out.
        variance: (n,) variance of the heights [m^2].
        geometry: the grid.
    """
    return rasterise_parts([(points, variance)], geometry)[0]


def rasterise_parts(parts: Sequence[tuple[Float, Float]], geometry: GridGeometry) -> list[CellSamples]:
    """The same for several sets of points and variances at once, each by itself."""
    # Coordinates in rows, each in one piece of memory; equal types, without which `at` below is many times slower.
    x, y, height = np.concatenate([points.T for points, _ in parts], axis=1, dtype=np.float64)
    spread = np.concatenate([variance for _, variance in parts], dtype=np.float64)
    place, inside = _places(x, y, height, geometry)
    outside = np.flatnonzero(~inside)
    if outside.size == place.size:
        return [NO_SAMPLES for _ in parts]
    place[outside] = place[inside.argmax()]
    # Each part has its own places; one more before its first takes what lies outside.
    start = int(place.min()) - 1
    place -= start
    place[outside] = 0
    span = int(place.max()) + 1
    end = len(parts[0][0])
    for number, (points, _) in enumerate(parts[1:], start=1):
        place[end : (end := end + len(points))] += number * span
    length = len(parts) * span
    high = np.full(length, -np.inf)
    low = np.full(length, np.inf)
    with np.errstate(invalid="ignore"):
        np.maximum.at(high, place, height)
        np.minimum.at(low, place, height)
        is_one_layer = (low > high - TOP_LAYER_M).all()
    if not is_one_layer:
        is_top = np.flatnonzero(height > high.take(place) - TOP_LAYER_M)
        place, height, spread = place.take(is_top), height.take(is_top), spread.take(is_top)
    count = np.bincount(place, minlength=length)
    count[::span] = 0
    used = np.flatnonzero(count)
    ix, iy = np.divmod(used % span + start, geometry.shape[0])
    cell = (iy * geometry.shape[1] + ix).astype(np.int32)
    total = _sum(place, height, length).take(used)
    singles = [layer.take(used).astype(np.float32) for layer in (count, _sum(place, spread, length), low, high)]
    ends = np.searchsorted(used, span * np.arange(1, len(parts))).tolist()
    return [
        CellSamples(cell[first:last], total[first:last], *(layer[first:last] for layer in singles))
        for first, last in zip([0, *ends], [*ends, used.size], strict=True)
    ]


def _places(
    x: Float, y: Float, height: Float, geometry: GridGeometry
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.bool_]]:
    """Places ix * ny + iy (n,) of points, and which points (n,) are known and lie on the grid; others have no place.

    The cells are those of `GridGeometry.indices`, counted along y because stripes run along y: few numbers apart.
    """
    ny, nx = geometry.shape
    scale = 1 / geometry.resolution
    column = x * scale
    column += ROUNDING - geometry.origin[0] * scale
    row = y * scale
    row += ROUNDING - geometry.origin[1] * scale
    with np.errstate(invalid="ignore"):
        inside = (column >= 0) & (column < nx) & (row >= 0) & (row < ny) & (height == height)
        # None inside is negative: to cut off the fraction is to round down.
        place = column.astype(np.int64)
        place *= ny
        place += row.astype(np.int64)
    return place, inside


def cells_of(points: Float, geometry: GridGeometry) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.bool_]]:
    """Flat cells iy * nx + ix (m,) of those points (n, 3) that are known and lie on the grid, and which these are."""
    x, y, height = np.asarray(points.T, dtype=np.float64)
    place, inside = _places(x, y, height, geometry)
    ix, iy = np.divmod(place[inside], geometry.shape[0])
    return iy * geometry.shape[1] + ix, inside


def _sum(cell: npt.NDArray[np.int64], weights: npt.NDArray[Any], size: int) -> Float:
    return np.asarray(np.bincount(cell, weights=weights, minlength=size), dtype=np.float64)


def merge(parts: Iterable[CellSamples], geometry: GridGeometry) -> Raster:
    """Bring the parts of all stripes together; the result does not depend on the order in which they were made."""
    parts = [part for part in parts if part.cell.size]
    shape = geometry.shape
    if not parts:
        nothing = np.full(shape, np.nan)
        return Raster(nothing, nothing, nothing, nothing, np.zeros(shape))
    total, count, variance_total, low, high = (
        np.concatenate([getattr(part, name) for part in parts])
        for name in ("total", "count", "variance_total", "low", "high")
    )
    # As numpy counts places: with any other type `at` is many times slower.
    cell = np.concatenate([part.cell for part in parts], dtype=np.intp)
    size = geometry.size
    highest = np.full(size, -np.inf, dtype=np.float32)
    lowest = np.full(size, np.inf, dtype=np.float32)
    np.maximum.at(highest, cell, high)
    np.minimum.at(lowest, cell, low)
    is_top = high > highest.take(cell) - np.float32(TOP_LAYER_M)
    counts = _sum(cell, count * is_top, size)
    known = counts > 0
    safe = np.where(known, counts, 1)
    mean = _sum(cell, total * is_top, size) / safe
    mean_variance = _sum(cell, variance_total * is_top, size) / safe
    nan = np.where(known, 0.0, np.nan)
    return Raster(
        elevation=(mean + nan).reshape(shape),
        variance=(mean_variance + nan).reshape(shape),
        low=np.asarray(nan + lowest, np.float64).reshape(shape),
        high=np.asarray(nan + highest, np.float64).reshape(shape),
        count=counts.reshape(shape),
    )


def without_cells(raster: Raster, cells: npt.NDArray[np.bool_]) -> Raster:
    """The same grid with some cells unknown."""

    def cut(layer: Float) -> Float:
        return np.where(cells, np.nan, layer)

    return Raster(
        elevation=cut(raster.elevation),
        variance=cut(raster.variance),
        low=cut(raster.low),
        high=cut(raster.high),
        count=np.where(cells, 0.0, raster.count),
    )


def pool(raster: Raster, factor: int) -> Raster:
    """Coarser cells from `factor` x `factor` fine ones, conservatively: one unknown fine cell makes all unknown."""
    if factor == 1:
        return raster
    ny, nx = (n // factor for n in raster.count.shape)

    def blocks(layer: Float) -> Float:
        return layer.reshape(ny, factor, nx, factor).swapaxes(1, 2).reshape(ny, nx, -1)

    return Raster(
        elevation=blocks(raster.elevation).mean(axis=-1),
        variance=blocks(raster.variance).mean(axis=-1),
        low=blocks(raster.low).min(axis=-1),
        high=blocks(raster.high).max(axis=-1),
        count=np.where(np.isfinite(blocks(raster.elevation)).all(axis=-1), blocks(raster.count).sum(axis=-1), 0),
    )


def pool_flags(flags: npt.NDArray[np.uint16], factor: int) -> npt.NDArray[np.uint16]:
    """Flags of coarser cells: those of any of their `factor` x `factor` fine ones."""
    ny, nx = (n // factor for n in flags.shape)
    blocks = flags.reshape(ny, factor, nx, factor).swapaxes(1, 2).reshape(ny, nx, -1)
    return np.asarray(np.bitwise_or.reduce(blocks, axis=-1), dtype=np.uint16)
