"""The cost of dark flashes in clean scans."""

import pytest

from benchmarks.strange_light import Cost, clean_cost
from testbed.scenes import OWN_DATA, recorded


@pytest.mark.slow
@pytest.mark.parametrize("triggered", [True, False])
def test_dark_flashes_cost_frames_and_no_cells(triggered: bool) -> None:
    """Two flashes in a sweep of 35 stripes: two frames."""
    cost = clean_cost(recorded(OWN_DATA / "scans" / "paper"), triggered=triggered, pairs=1)
    assert cost.frames == 2 and cost.time > 0 and cost.is_met


def test_a_cost_must_be_low_in_cells_and_in_time_or_frames() -> None:
    """Four frames are allowed of a short scan, of which they are more than 6 %."""
    costs = [Cost(0.5, 2.0, 6.0, 9.0), Cost(0.0, 0.0, 8.0, 4.0), Cost(0.6, 0.6, 1.0, 1.0), Cost(0.0, 0.0, 6.1, 4.5)]
    assert [cost.is_met for cost in costs] == [True, True, False, False]
