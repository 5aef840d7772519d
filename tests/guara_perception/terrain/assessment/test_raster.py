"""Samples summed per cell: comparison with brute force, top layer, joint swaths, conservative pooling."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from guara_perception.terrain.assessment.raster import (
    TOP_LAYER_M,
    SurfaceSamples,
    cells_of,
    merge,
    pool,
    pool_flags,
    rasterise,
    rasterise_swaths,
    without_cells,
)
from guara_perception.terrain.layers.geometry import GridGeometry
from tests.thorough import examples

GRID = GridGeometry((0.5, -0.27), 0.005, (6, 8))


def cloud(seed: int, n: int = 200) -> np.ndarray:
    random = np.random.default_rng(seed)
    points = random.uniform((0.49, -0.28, -0.02), (0.55, -0.23, 0.08), (n, 3))
    points[random.random(n) < 0.1, 2] = np.nan
    return points


@given(seed=st.integers(0, 10_000), swaths=st.integers(1, 5))
@settings(max_examples=examples(40), deadline=None, derandomize=True)
def test_mean_of_the_top_layer(seed: int, swaths: int) -> None:
    """For each cell: lowest and highest of all samples, mean of those in the top layer."""
    points = cloud(seed)
    points[:, 2] = np.round(points[:, 2] / 0.02) * 0.02  # Layers far apart, so that swaths cannot split a layer.
    variance = np.full(len(points), 1e-6)
    pieces = np.array_split(np.arange(len(points)), swaths)
    raster = merge([rasterise(points[i], variance[i], GRID) for i in pieces], GRID)
    for iy in range(6):
        for ix in range(8):
            inside = (
                np.isfinite(points[:, 2])
                & (np.floor((points[:, 0] - 0.5) / 0.005 + 1e-6) == ix)
                & (np.floor((points[:, 1] + 0.27) / 0.005 + 1e-6) == iy)
            )
            if not inside.any():
                assert np.isnan(raster.elevation[iy, ix])
                continue
            heights = points[inside, 2]
            top = heights[heights > heights.max() - TOP_LAYER_M]
            assert raster.elevation[iy, ix] == pytest.approx(top.mean(), abs=1e-12)
            assert (raster.low[iy, ix], raster.high[iy, ix]) == pytest.approx((heights.min(), heights.max()), abs=1e-8)
            assert raster.variance[iy, ix] == pytest.approx(1e-6)


@given(seed=st.integers(0, 10_000))
@settings(max_examples=examples(20), deadline=None, derandomize=True)
def test_swaths_together_are_the_swaths_alone(seed: int) -> None:
    """Several sets of samples at once, in mixed runs, one empty, one off the grid: each as if alone."""
    random = np.random.default_rng(seed)
    points = [cloud(seed), np.empty((0, 3)), cloud(seed + 1, 50), cloud(seed + 2) + (9.0, 0.0, 0.0), cloud(seed + 3)]
    points[4][:, 0] += 0.02
    runs = [(swath, run) for swath, each in enumerate(points) for run in np.array_split(each, random.integers(1, 4))]
    runs = sorted((run for run in runs if len(run[1])), key=lambda run: (len(run[1]) % 3, run[0]))
    every = np.concatenate([run for _, run in runs])
    samples = SurfaceSamples(every.T.copy(), np.full(len(every), 1e-6), [(swath, len(run)) for swath, run in runs])
    order = [[run for number, run in runs if number == swath] for swath in range(len(points))]
    for together, each in zip(rasterise_swaths(samples, len(points), GRID), order, strict=True):
        alone = rasterise(np.concatenate([np.empty((0, 3)), *each]), np.full(sum(map(len, each)), 1e-6), GRID)
        for name in ("cell", "total", "count", "variance_total", "low", "high"):
            np.testing.assert_array_equal(getattr(together, name), getattr(alone, name))
            assert getattr(together, name).dtype == getattr(alone, name).dtype


def test_no_swath_at_all() -> None:
    """Swaths without a run have no cells."""
    nothing = SurfaceSamples(np.empty((3, 0)), np.empty(0), [])
    assert rasterise_swaths(nothing, 0, GRID) == []
    assert [swath.cell.size for swath in rasterise_swaths(nothing, 2, GRID)] == [0, 0]


def test_a_point_unknown_in_one_coordinate_is_left_out() -> None:
    """Whichever coordinate is NaN, the cell consists of its other points."""
    points = np.tile([0.512, -0.262, 0.01], (4, 1))
    points[0, 0] = points[1, 1] = points[2, 2] = np.nan
    raster = merge([rasterise(points, np.full(4, 1e-6), GRID)], GRID)
    known = np.isfinite(raster.elevation)
    assert known[1, 2] and known.sum() == 1
    assert cells_of(points, GRID)[1].tolist() == [False, False, False, True]


def test_cells_are_those_of_the_geometry() -> None:
    """For known points on the grid, also on borders of cells: the cells of `GridGeometry.indices`."""
    border = np.array([[0.5 + 0.005 * i, -0.27 + 0.005 * j, 0.0] for i in range(-1, 10) for j in range(-1, 8)])
    points = np.concatenate((cloud(3), border))
    cell, inside = cells_of(points, GRID)
    iy, ix = GRID.indices(points[:, 0], points[:, 1])
    np.testing.assert_array_equal(inside, GRID.contains(iy, ix) & np.isfinite(points[:, 2]))
    np.testing.assert_array_equal(cell, (iy * GRID.shape[1] + ix)[inside])


def test_nothing_gives_nothing() -> None:
    """No swath, and swaths without a sample on the grid, give unknown cells."""
    outside = rasterise(np.array([[9.0, 9.0, 0.0], [np.nan, 0, 0]]), np.zeros(2), GRID)
    for raster in (merge([], GRID), merge([outside], GRID)):
        assert np.isnan(raster.elevation).all()


def test_half_open_cells() -> None:
    """A point on the border of two cells belongs to the upper one; one on the grid's end to none."""
    points = np.array([[0.505, -0.265, 0.01], [0.54, -0.25, 0.02]])
    raster = merge([rasterise(points, np.zeros(2), GRID)], GRID)
    assert raster.elevation[1, 1] == 0.01
    assert np.isfinite(raster.elevation).sum() == 1


def test_pooling_leaves_no_gap_unseen() -> None:
    """One unknown fine cell makes the coarse cell unknown; flags of all fine cells are kept."""
    points = np.array([[x, y, 0.01] for x in np.arange(0.5025, 0.54, 0.005) for y in np.arange(-0.2675, -0.24, 0.005)])
    whole = merge([rasterise(points, np.full(len(points), 1e-6), GRID)], GRID)
    assert np.isfinite(pool(whole, 2).elevation).all() and pool(whole, 2).elevation.shape == (3, 4)
    cells = np.zeros((6, 8), bool)
    cells[3, 5] = True
    holed = pool(without_cells(whole, cells), 2)
    np.testing.assert_array_equal(np.argwhere(np.isnan(holed.elevation)), [[1, 2]])
    assert pool(whole, 1) is whole
    flags = np.zeros((6, 8), np.uint16)
    flags[3, 5], flags[2, 4] = 8, 1
    assert pool_flags(flags, 2)[1, 2] == 9 and pool_flags(flags, 2).sum() == 9
