"""The matrix of restarts: no grid that the truth contradicts is handed out, and many are withheld."""

import pytest

from benchmarks.restarts import EVENTS, Count, run_matrix, run_walks
from tests.thorough import further


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, *further(4, 5, 6)])
def test_no_walk_is_given_ground_that_the_truth_contradicts(seed: int) -> None:
    """Random walks of nodes, links and pauses."""
    count = run_walks(30, seed)
    assert count.cases == 30 and count.handed_out > 0
    assert count.contradictions == 0 and count.withheld > 0


@pytest.mark.heavy
def test_no_case_of_the_matrix_is_given_ground_that_the_truth_contradicts() -> None:
    """Each moment, event and act of the gait."""
    count: Count = run_matrix()
    assert count.cases == 4 * len(EVENTS) * 6 * 3 * 2
    assert count.contradictions == 0 and count.handed_out > 100_000
