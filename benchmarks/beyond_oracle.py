"""Why cells are free in a grid and not by the oracle: which true hazard lies under the sole, where, and by how much."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

import guara_perception as gp
from guara_perception.arrays import Float
from guara_perception.terrain.assessment.edges import half_cells
from guara_perception.terrain.layers.hazard import Hazard

# A layer, the flag of its test, its limit's name, and what one unit of it is called and counts.
TESTS = (
    ("slope", Hazard.STEEP, "slope", "degrees", 180 / np.pi),
    ("step_height", Hazard.DROP, "drop", "mm", 1e3),
    ("step_height", Hazard.STEP, "step", "mm", 1e3),
    ("roughness", Hazard.ROUGH, "roughness", "mm", 1e3),
)
# Hazards so near to one another are one place of the ground [m].
SAME_GROUND_M = 0.03


@dataclass(frozen=True)
class Beyond:
    """One cell that is free and should not be.

    Attributes:
        hazard_at: (2,) where the true hazard under its sole is [m].
        at_rim: whether all true hazards under the sole lie in the outermost row or column of its window.
        cells: true hazards under the sole.
        exceeded: each test that the truth fails there: name, by truth, by the grid, limit, in the unit.
    """

    hazard_at: Float
    at_rim: bool
    cells: int
    exceeded: tuple[tuple[str, float, float, float, str], ...]


def beyond_oracle(fused: gp.TerrainGrid, oracle: gp.TerrainGrid, to_world: Float) -> Iterator[Beyond]:
    """Cells that are free in a grid and not in the oracle.

    Args:
        fused: the grid.
        oracle: the same if all of it were known exactly.
        to_world: (4, 4) from its base_footprint to where places are compared.
    """
    limits = oracle.metadata["limits"]
    half_y, half_x = (half_cells(limits[name], fused.resolution) for name in ("sole_width", "sole_length"))
    x, y = fused.geometry.centres()
    for iy, ix in np.argwhere((fused.hazard == 0) & (oracle.hazard != 0)).tolist():
        rows = slice(max(iy - half_y, 0), iy + half_y + 1)
        columns = slice(max(ix - half_x, 0), ix + half_x + 1)
        bad_y, bad_x = np.nonzero(oracle.hazard[rows, columns] & ~np.uint16(Hazard.EDGE))
        if not bad_y.size:
            continue
        bad_y, bad_x = bad_y + rows.start, bad_x + columns.start
        at_rim = (np.abs(bad_y - iy) == half_y) | (np.abs(bad_x - ix) == half_x)
        flags = oracle.hazard[bad_y, bad_x]
        exceeded = []
        for layer, flag, name, unit, scale in TESTS:
            failed = np.flatnonzero(flags & np.uint16(flag))
            if failed.size:
                cell = bad_y[failed], bad_x[failed]
                true = float(np.max(oracle.layers[layer][cell]))
                # Unknown cells of the grid have no value.
                measured = float(np.nanmax(np.append(fused.layers[layer][cell], 0.0)))
                exceeded.append((name, scale * true, scale * measured, scale * limits[name], unit))
        centre = np.array([x[bad_x].mean(), y[bad_y].mean(), 0.0, 1.0])
        yield Beyond((to_world @ centre)[:2], bool(at_rim.all()), bad_y.size, tuple(exceeded))


def explained(found: list[Beyond]) -> Iterator[str]:
    """One line for each place of the ground whose hazard cells do not show in the grid."""
    left = list(found)
    while left:
        first = left[0].hazard_at
        here = [each for each in left if np.abs(each.hazard_at - first).max() <= SAME_GROUND_M]
        left = [each for each in left if np.abs(each.hazard_at - first).max() > SAME_GROUND_M]
        rim = Counter(each.at_rim for each in here)
        tests = sorted({test for each in here for test in each.exceeded})
        worst = {name: max(test for test in tests if test[0] == name) for name in dict.fromkeys(t[0] for t in tests)}
        causes = ", ".join(
            f"{name} {true:.1f} {unit} by truth, {measured:.1f} here, limit {limit:.1f}"
            for name, true, measured, limit, unit in worst.values()
        )
        yield (
            f"    {len(here)} cells beside x={first[0]:.2f} y={first[1]:.2f}, hazard at the rim of the sole's window "
            f"in {rim[True]}, up to {max(each.cells for each in here)} cells of it: {causes}"
        )
