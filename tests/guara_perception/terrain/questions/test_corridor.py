"""The corridor of a path holds every cell within the clearance of any of its points, and none much farther off."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from guara_perception.terrain.layers.geometry import GridGeometry
from guara_perception.terrain.questions.corridor import corridor_of, sampled
from tests.thorough import examples

GRID = GridGeometry((-0.1, -0.1), 0.005, (40, 40))
WITHIN = st.floats(-0.0999, 0.0999)
# Points of the whole path that the cells are compared with lie this near to one another.
FINE_M = 5e-4


@settings(max_examples=examples(100), derandomize=True)
@given(st.lists(st.tuples(WITHIN, WITHIN, st.floats(0, 0.1)), min_size=1, max_size=4), st.floats(0, 0.04))
def test_the_corridor_is_what_lies_within_the_clearance(points: list[tuple[float, float, float]], clearance: float):
    """Also between two samples and beyond the border of the grid: by brute force over a path cut five times finer."""
    path = np.array(points)
    iy, ix = corridor_of(GRID, sampled(path, GRID.resolution / 2), clearance).unique()
    found = set(zip(iy.tolist(), ix.tolist(), strict=True))
    fine = sampled(path, FINE_M)
    rows = np.arange(-10, 50)
    x, y = (GRID.origin[axis] + (rows + 0.5) * GRID.resolution for axis in (0, 1))
    over_x = np.maximum(np.abs(x[:, None] - fine[:, 0]) - GRID.resolution / 2, 0)
    over_y = np.maximum(np.abs(y[:, None] - fine[:, 1]) - GRID.resolution / 2, 0)
    for row, aside_y in zip(rows, over_y, strict=True):
        distance = np.hypot(over_x, aside_y).min(axis=1)
        corridor = np.array([(int(row), int(column)) in found for column in rows])
        assert corridor[distance <= clearance - FINE_M].all()
        assert not corridor[distance > clearance + GRID.resolution / 4 + FINE_M].any()
