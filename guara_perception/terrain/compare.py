"""Comparison of two grids with the same cells."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from guara_perception.arrays import Float
from guara_perception.exceptions import InvalidInput
from guara_perception.terrain.file import load_terrain
from guara_perception.terrain.layers.layered_grid import LayeredGrid
from guara_perception.terrain.questions.points import known_cells
from kinematics.arrays import FrozenArrays


@dataclass(frozen=True, eq=False)
class GridComparison(FrozenArrays):
    """Differences between a reference grid a and a grid b.

    Attributes:
        difference: (ny, nx) float64 height of b minus height of a [m]; NaN where either is unknown.
        known_in_both, known_only_in_a, known_only_in_b: numbers of cells.
        free_in_both, free_only_in_a, free_only_in_b: numbers of traversable cells.
        mean, rms, largest: mean, rms and largest magnitude of the difference over the cells known in both [m]; NaN
            without any.
    """

    difference: Float
    known_in_both: int
    known_only_in_a: int
    known_only_in_b: int
    free_in_both: int
    free_only_in_a: int
    free_only_in_b: int
    mean: float
    rms: float
    largest: float

    def __repr__(self) -> str:
        return (
            f"GridComparison: heights b - a: mean {1e3 * self.mean:+.3f} mm, rms {1e3 * self.rms:.3f} mm, "
            f"largest {1e3 * self.largest:.3f} mm\n"
            f"  known in both {self.known_in_both}, "
            f"only in a {self.known_only_in_a}, only in b {self.known_only_in_b}\n"
            f"  free in both {self.free_in_both}, only in a {self.free_only_in_a}, only in b {self.free_only_in_b}"
        )


def compare(a: LayeredGrid | str | Path, b: LayeredGrid | str | Path) -> GridComparison:
    """Compare two grids cell by cell.

    Args:
        a: reference grid, or the path of its file.
        b: grid of the same cells (equal origin, resolution and shape), or the path of its file.

    Raises:
        InvalidInput: the grids have different cells, or an argument is not a grid.
        MissingFile, FileFormatError: a file is missing or does not contain a grid.
    """
    a, b = (load_terrain(grid) if isinstance(grid, str | Path) else grid for grid in (a, b))
    for name, grid in (("a", a), ("b", b)):
        if not isinstance(grid, LayeredGrid):
            raise InvalidInput(f"{name} is {type(grid).__name__}; allowed: a grid, or the path of its file")
    same = a.shape == b.shape and np.isclose(a.resolution, b.resolution, rtol=1e-9, atol=0)
    if not same or not np.allclose(a.origin, b.origin, rtol=0, atol=1e-6 * a.resolution):
        raise InvalidInput(
            f"a has {a.shape} cells of {a.resolution:g} m from {a.origin}, b has {b.shape} of {b.resolution:g} m from "
            f"{b.origin}; allowed: grids of the same cells (equal origin, resolution and shape)"
        )
    known_a, known_b = known_cells(a), known_cells(b)
    free_a, free_b = a.layers["traversability"] > 0, b.layers["traversability"] > 0
    difference = b.layers["elevation"].astype(np.float64) - a.layers["elevation"]
    both = known_a & known_b
    values = difference[both] if both.any() else np.full(1, np.nan)
    return GridComparison(
        difference=difference,
        known_in_both=int(both.sum()),
        known_only_in_a=int((known_a & ~known_b).sum()),
        known_only_in_b=int((known_b & ~known_a).sum()),
        free_in_both=int((free_a & free_b).sum()),
        free_only_in_a=int((free_a & ~free_b).sum()),
        free_only_in_b=int((free_b & ~free_a).sum()),
        mean=float(values.mean()),
        rms=float(np.sqrt(np.mean(values**2))),
        largest=float(np.abs(values).max()),
    )
