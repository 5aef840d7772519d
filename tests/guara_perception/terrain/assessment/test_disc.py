"""Window around the sole: as wide as the tests read, so that unknown ground of any shape makes no free cell unsafe."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import guara_perception as gp
from guara_perception.settings import TraversabilityLimits
from guara_perception.terrain.assessment.assess import assess_layers
from guara_perception.terrain.assessment.disc import edge_cells
from guara_perception.terrain.assessment.raster import Raster
from guara_perception.terrain.layers.geometry import (
    LARGEST_DRIFT_CELLS,
    TOUCHED,
    disc_kernel,
    half_cells,
    widest_window,
)
from guara_perception.terrain.layers.hazard import ALL_BUT_EDGE, Hazard
from tests.thorough import examples

RESOLUTION = 0.005
GRIDS = examples(150)


def assessed(heights: np.ndarray, limits: TraversabilityLimits, drift: np.ndarray | None) -> np.ndarray:
    """Hazards of heights (NaN = unknown) with a small variance."""
    variance = np.where(np.isfinite(heights), 1e-7, np.nan)
    nothing = np.zeros(heights.shape, np.uint16)
    return assess_layers(Raster(heights, variance, heights, heights), nothing, RESOLUTION, limits, drift)["hazard"]


def ground(rng: np.random.Generator) -> np.ndarray:
    """Tilted, slightly rough ground with a box or a trench, 60 x 64 cells."""
    y, x = np.mgrid[:60, :64] * RESOLUTION
    heights = rng.uniform(-0.1, 0.1) * x + rng.uniform(-0.1, 0.1) * y + rng.normal(0, 2e-4, x.shape)
    iy, ix = rng.integers(0, 55, 2)
    heights[iy : iy + 6, ix : ix + 8] += rng.choice([0.0, 0.03, -0.03])
    return heights


def holes(rng: np.random.Generator, shape: tuple[int, int]) -> np.ndarray:
    """Patches of a cell to a quarter of the grid, some at the border."""
    mask = np.zeros(shape, dtype=bool)
    for _ in range(rng.integers(1, 5)):
        iy, ix = rng.integers(0, shape[0]), rng.integers(0, shape[1])
        height, width = rng.integers(1, 15, 2)
        mask[iy : iy + height, ix : ix + width] = True
    return mask


def fillings(rng: np.random.Generator, heights: np.ndarray, lost: np.ndarray) -> list[np.ndarray]:
    """Possible unknown ground: the truth, a pit, a wall, needles, chequers, slopes, noise, extrapolations."""
    y, x = np.mgrid[: heights.shape[0], : heights.shape[1]]
    candidates = [
        heights,
        heights - 0.5,
        heights + 0.5,
        heights + 0.1 * (rng.random(heights.shape) < 0.2),
        heights + 0.03 * ((x + y) % 2),
        heights + 0.01 * x,
        heights + rng.normal(0, 0.02, heights.shape),
        heights - 0.0005 * (x - 30) ** 2,
    ]
    return [np.where(lost, other, heights) for other in candidates]


@pytest.mark.slow
@pytest.mark.parametrize("is_map", [False, True], ids=["scan", "map"])
def test_no_filling_of_the_unknown_makes_a_free_cell_unsafe(limits: TraversabilityLimits, is_map: bool) -> None:
    """Random grids with 8 fillings each: no filling puts a hazard under the sole on a free cell."""
    rng = np.random.default_rng(11)
    sole = np.ones([2 * half_cells(n, RESOLUTION) + 1 for n in (limits.sole_width, limits.sole_length)], np.uint8)
    free_cells = 0
    for _ in range(GRIDS):
        heights = ground(rng)
        lost = holes(rng, heights.shape)
        drift = rng.integers(0, LARGEST_DRIFT_CELLS + 1, (*heights.shape, 2)) if is_map else None
        free = assessed(np.where(lost, np.nan, heights), limits, drift) == 0
        free_cells += int(free.sum())
        for filled in fillings(rng, heights, lost):
            hazard = assessed(filled, limits, drift)
            bad = ((hazard & ALL_BUT_EDGE) != 0).astype(np.uint8)
            assert not (free & (cv2.dilate(bad, sole) > 0)).any()
            # Nor does it get a flag: removing the filling (losing cells) frees no cell.
            assert not (free & (hazard != 0)).any()
    assert free_cells > 60 * GRIDS


@pytest.mark.slow
@settings(max_examples=examples(40), deadline=None, derandomize=True)
@given(st.integers(0, 10_000))
def test_losing_cells_never_frees_another_whatever_the_drift(seed: int) -> None:
    """Exact as on a single scan, for any drift of each cell: the margin depends only on the tested cell."""
    rng = np.random.default_rng(seed)
    heights = ground(rng)
    heights[holes(rng, heights.shape) & (rng.random(heights.shape) < 0.5)] = np.nan
    drift = rng.integers(0, LARGEST_DRIFT_CELLS + 1, (*heights.shape, 2))
    limits = dataclasses.replace(gp.TraversabilityLimits(**gp.assess_terrain([[0.0]], 1.0).metadata["limits"]))
    before = assessed(heights, limits, drift)
    after = assessed(np.where(holes(rng, heights.shape), np.nan, heights), limits, drift)
    assert not ((after == 0) & (before != 0)).any()


def test_a_narrower_window_would_be_broken(limits: TraversabilityLimits) -> None:
    """The fillings are hard enough: without the rim of the discs in the window, free cells become unsafe."""
    rng = np.random.default_rng(11)
    broken = 0
    sole = np.ones([2 * half_cells(n, RESOLUTION) + 1 for n in (limits.sole_width, limits.sole_length)], np.uint8)
    for _ in range(10):
        heights = ground(rng)
        lost = holes(rng, heights.shape)
        flags = assessed(np.where(lost, np.nan, heights), limits, None) & ALL_BUT_EDGE
        around = cv2.dilate((flags != 0).astype(np.uint8), sole, borderType=cv2.BORDER_CONSTANT, borderValue=(1,))
        for filled in fillings(rng, heights, lost):
            bad = ((assessed(filled, limits, None) & ALL_BUT_EDGE) != 0).astype(np.uint8)
            broken += int(((around == 0) & (cv2.dilate(bad, sole) > 0)).sum())
    assert broken > 1000


@pytest.mark.parametrize("drift", [None, (0, 0), (0, 1), (3, 1), (4, 3), (6, 5)])
def test_the_window_of_one_unknown_cell(limits: TraversabilityLimits, drift: tuple[int, int] | None) -> None:
    """Exactly the sole, the disc and one more ring; in a map, as many rings as the drift exceeds the disc's radius.

    The disc contains all cells that a circle of its radius touches.
    """
    flags = np.zeros((81, 81), np.uint16)
    flags[40, 40] = Hazard.UNSCANNED
    kernel = disc_kernel(limits.disc_radius / RESOLUTION)
    cells = None if drift is None else np.full((*flags.shape, 2), drift)
    edge = edge_cells(flags, kernel, RESOLUTION, limits, cells)[25:56, 25:56]
    more = {None: (1, 1), (0, 0): (1, 1), (0, 1): (1, 1), (3, 1): (1, 1), (4, 3): (1, 1), (6, 5): (3, 2)}[drift]
    sizes = zip((limits.sole_width, limits.sole_length), more, strict=True)
    half = [half_cells(length, RESOLUTION) + beside for length, beside in sizes]
    expected = np.zeros(edge.shape, dtype=bool)
    # Points all over each cell, in units of the cell edge, relative to the centre of the circle.
    fine = np.abs(np.linspace(-3.5, 3.5, 7 * 40 + 1))[:, None]
    within = np.hypot(fine, fine.T) <= 3
    cells_of_disc = np.array(
        [[within[40 * i : 40 * i + 41, 40 * j : 40 * j + 41].any() for j in range(7)] for i in range(7)]
    )
    for dy, dx in zip(*np.nonzero(cells_of_disc), strict=True):
        iy, ix = 15 + dy - kernel.shape[0] // 2, 15 + dx - kernel.shape[1] // 2
        expected[iy - half[0] : iy + half[0] + 1, ix - half[1] : ix + half[1] + 1] = True
    np.testing.assert_array_equal(edge, expected)
    iy, ix = np.nonzero(expected)
    farthest = np.hypot(np.abs(iy - 15) + 0.5, np.abs(ix - 15) + 0.5).max() * RESOLUTION
    assert farthest <= widest_window(kernel, RESOLUTION, limits, is_map=drift is not None) + 1e-12


@pytest.mark.parametrize("radius", [1.0, 1.4, 1.5, 1.875, 2.5, 3.0, 3.75])
def test_a_disc_has_each_cell_that_its_circle_touches(radius: float) -> None:
    """For cells of any size; no other cell, nor one that the circle meets in a single point."""
    kernel = disc_kernel(radius, TOUCHED)
    cells = np.arange(-6, 7)
    nearest = np.maximum(np.abs(cells) - 0.5, 0.0)
    expected = np.hypot(nearest[:, None], nearest) < radius - 1e-9
    np.testing.assert_array_equal(np.pad(kernel > 0, 6 - kernel.shape[0] // 2), expected)


def test_a_cell_that_drifted_far_keeps_further_from_a_hazard(limits: TraversabilityLimits) -> None:
    """Drift beyond the disc's radius widens the margin to hazards and to unknown cells alike."""
    for flag in (Hazard.STEP, Hazard.UNSCANNED):
        flags = np.zeros((81, 81), np.uint16)
        flags[40, 40] = flag
        kernel = disc_kernel(limits.disc_radius / RESOLUTION)
        sizes = [
            int(edge_cells(flags, kernel, RESOLUTION, limits, np.full((*flags.shape, 2), cells)).sum())
            for cells in range(LARGEST_DRIFT_CELLS + 1)
        ]
        assert sizes[0] == sizes[1] == sizes[2] == sizes[3] == sizes[4]
        assert (np.diff(sizes[4:]) > 0).all()


@pytest.mark.slow
@pytest.mark.parametrize("most", [1, 3, LARGEST_DRIFT_CELLS])
def test_ground_that_moved_sideways_under_the_map(limits: TraversabilityLimits, most: int) -> None:
    """150 grounds, moved under the map within its drift: by one cell, no free cell is truly unsafe.

    For larger drifts up to the limit, no rise or fall that is too large and nothing unknown comes under the sole.
    """
    rng = np.random.default_rng(most)
    sole = np.ones([2 * half_cells(n, RESOLUTION) + 1 for n in (limits.sole_width, limits.sole_length)], np.uint8)
    free_cells = moved_cells = 0
    for _ in range(GRIDS):
        heights = ground(rng)
        heights[holes(rng, heights.shape)] = np.nan
        sigmas = rng.integers(0, most + 1, 2) if most > 1 else np.ones(2, int)
        angle = rng.uniform(0, 2 * np.pi)
        # Anywhere within the ellipse of the sigmas; for one cell, also in the corners.
        shift = np.trunc(sigmas * [np.sin(angle), np.cos(angle)]).astype(int) if most > 1 else rng.integers(-1, 2, 2)
        drift = np.full((*heights.shape, 2), sigmas)
        free = assessed(heights, limits, drift) == 0
        true = np.roll(heights, shift, (0, 1))
        known = np.isfinite(true)
        free_cells += int(free.sum())
        moved_cells += int(free.sum()) if shift.any() else 0
        lowest, highest = np.where(known, true, 1e3), np.where(known, true, -1e3)
        # Relative to a plane, because the ground is tilted by up to 0.1.
        relief = cv2.dilate(highest, sole) - cv2.erode(lowest, sole) - 0.15 * np.hypot(*sole.shape) * RESOLUTION
        unknown = cv2.dilate((~known).astype(np.uint8), sole) > 0
        assert not (free & (unknown | (relief > limits.drop))).any()
        if most == 1:
            bad = ((assessed(true, limits, np.zeros_like(drift)) & ALL_BUT_EDGE) != 0).astype(np.uint8)
            assert not (free & (cv2.dilate(bad, sole) > 0)).any()
    assert free_cells > 400 * GRIDS and moved_cells > 200 * GRIDS
