"""Cells that a lost frame may have shown."""

from __future__ import annotations

from typing import Any

import numpy as np

from guara_perception.scanning.scan_surface import lost_cells
from guara_perception.terrain.layers.hazard import Hazard

# Laser planes that meet the floor at x = 0.5, 0.6, ... and lean: at a height of 0.1 m they are 0.05 m farther back.
PLANES = np.array([[1.0, 0.0, 0.5, -x] for x in (0.5, 0.6, 0.7, 0.8, 0.9)])


def columns(runs: list[list[int]], scan_grid: Any) -> np.ndarray:
    """Coordinates x of the marked columns."""
    return scan_grid.centres()[0][sorted({ix for ix, _, _ in runs})]


def test_on_flat_ground_the_two_neighbouring_strips_are_lost(scan_grid: Any) -> None:
    """If the stripe at 0.7 is lost, exactly the unscanned cells from 0.6 to 0.8 over the whole width are lost."""
    flat = np.zeros(scan_grid.shape)
    hazard = np.full(scan_grid.shape, np.uint16(Hazard.UNSCANNED))
    view = np.ones(scan_grid.shape, dtype=bool)
    lost = np.array([False, False, True, False, False])
    runs = lost_cells(flat, hazard, view, PLANES, lost, scan_grid)
    x = columns(runs, scan_grid)
    assert x.min() > 0.6
    assert x.max() < 0.8
    assert all((first, end) == (0, 108) for _, first, end in runs)
    assert len(runs) == 40


def test_only_unknown_cells_in_view_are_reported(scan_grid: Any) -> None:
    """Known cells, dropouts and cells out of view are not lost."""
    flat, view = np.zeros(scan_grid.shape), np.ones(scan_grid.shape, dtype=bool)
    hazard = np.zeros(scan_grid.shape, np.uint16)
    lost = np.array([False, False, True, False, False])
    assert lost_cells(flat, hazard, view, PLANES, lost, scan_grid) == ()
    hazard[:] = Hazard.DROPOUT
    assert lost_cells(flat, hazard, view, PLANES, lost, scan_grid) == ()
    hazard[:] = Hazard.UNSCANNED
    view[20:] = False
    assert {(first, end) for _, first, end in lost_cells(flat, hazard, view, PLANES, lost, scan_grid)} == {(0, 20)}
    assert lost_cells(flat, hazard, view, PLANES, np.zeros(5, dtype=bool), scan_grid) == ()


def test_on_high_ground_the_strip_lies_further_back(scan_grid: Any) -> None:
    """With a box of 100 mm in the scan, the lost stripe may have shown cells 50 mm nearer."""
    boxed = np.zeros(scan_grid.shape)
    boxed[50, 10] = 0.1
    hazard = np.full(scan_grid.shape, np.uint16(Hazard.OCCLUDED))
    view = np.ones(scan_grid.shape, dtype=bool)
    runs = lost_cells(boxed, hazard, view, PLANES, np.array([False, False, True, False, False]), scan_grid)
    x = columns(runs, scan_grid)
    assert 0.55 < x.min() < 0.56
    assert 0.79 < x.max() < 0.8
