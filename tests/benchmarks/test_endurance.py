"""Three minutes of the run of hours: real processes over real Zenoh, faults at random; nothing grows or contradicts."""

import subprocess

import pytest

from benchmarks.endurance import Outcome, Size, endure


@pytest.mark.heavy
def test_nothing_grows_and_no_grid_is_contradicted() -> None:
    """A walking node that records, two planners and a viewer; node and planner are killed and stopped."""
    outcome = endure(3.0, 12.0, seed=1)
    assert sum(outcome.faults.values()) >= 3
    assert outcome.counts["new maps"] > 0 and outcome.counts["footprint handed out"] > 0
    assert outcome.counts["contradictions"] == outcome.counts["out of order"] == 0
    assert outcome.sizes.keys() == {"router", "planner", "viewer", "node"}
    assert outcome.is_flat, outcome.sizes
    assert outcome.recorded > 0
    # Two journals, and one that is being written or was when the node was killed.
    assert 0 < len(outcome.journals) <= 3
    assert max(outcome.journals.values()) < 8e6


def test_growth_is_told() -> None:
    """Of memory, handles or threads, in any process that lives on."""
    small = Size(100.0, 20, 8)
    for larger in (Size(400.0, 20, 8), Size(100.0, 40, 8), Size(100.0, 20, 30)):
        assert not Outcome(sizes={"router": [small, small], "viewer": [small, larger]}).is_flat
    assert Outcome(sizes={"router": [small, Size(110.0, 22, 9)]}).is_flat
    with subprocess.Popen(["sleep", "60"]) as process:
        assert Size.of(process.pid).threads == 1
        process.kill()
