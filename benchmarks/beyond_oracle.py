"""True hazards under the sole of cells that are free in a grid and not by the oracle."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

import guara_perception as gp
from guara_perception.arrays import Float
from guara_perception.terrain.assessment.disc import half_cells
from guara_perception.terrain.layers.hazard import Hazard

# Layer, flag of its test, name of its limit, unit in which it is printed, and the factor from the layer's unit to it.
TESTS = (
    ("slope", Hazard.STEEP, "slope", "degrees", 180 / np.pi),
    ("step_height", Hazard.DROP, "drop", "mm", 1e3),
    ("step_height", Hazard.STEP, "step", "mm", 1e3),
    ("roughness", Hazard.ROUGH, "roughness", "mm", 1e3),
)
# Cells whose hazards are this near to one another are explained together [m].
SAME_GROUND_M = 0.03


@dataclass(frozen=True)
class Beyond:
    """One cell that is free in the grid and not in the oracle.

    Attributes:
        hazard_at: (2,) mean position of the true hazards under a sole centred on the cell, in the world [m].
        at_rim: whether all true hazards under the sole lie in the outermost row or column of its window.
        cells: number of cells under the sole that are truly hazards.
        exceeded: each test that the truth fails there: name of the limit, true value, value in the grid, limit, unit.
    """

    hazard_at: Float
    at_rim: bool
    cells: int
    exceeded: tuple[tuple[str, float, float, float, str], ...]


def beyond_oracle(
    fused: gp.TerrainGrid, oracle: gp.TerrainGrid, transform_footprint_to_world: Float
) -> Iterator[Beyond]:
    """Cells that are free in a grid and not in the oracle.

    Args:
        fused: the grid that is judged.
        oracle: the grid as it would be if every cell of it were known exactly.
        transform_footprint_to_world: (4, 4); positions are compared in the world.
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
        mean_position = np.array([x[bad_x].mean(), y[bad_y].mean(), 0.0, 1.0])
        yield Beyond(
            (transform_footprint_to_world @ mean_position)[:2], bool(at_rim.all()), bad_y.size, tuple(exceeded)
        )


def explained(found: list[Beyond]) -> Iterator[str]:
    """One line of text for each group of neighbouring hazards that the grid does not show."""
    left = list(found)
    while left:
        first = left[0].hazard_at
        group = [each for each in left if np.abs(each.hazard_at - first).max() <= SAME_GROUND_M]
        left = [each for each in left if np.abs(each.hazard_at - first).max() > SAME_GROUND_M]
        rim = Counter(each.at_rim for each in group)
        tests = sorted({test for each in group for test in each.exceeded})
        worst = {name: max(test for test in tests if test[0] == name) for name in dict.fromkeys(t[0] for t in tests)}
        causes = ", ".join(
            f"{name} {true:.1f} {unit} by truth, {measured:.1f} here, limit {limit:.1f}"
            for name, true, measured, limit, unit in worst.values()
        )
        yield (
            f"    {len(group)} cells near x={first[0]:.2f} y={first[1]:.2f}, hazard at the rim of the sole's window "
            f"in {rim[True]}, up to {max(each.cells for each in group)} cells of it: {causes}"
        )
