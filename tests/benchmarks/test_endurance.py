"""Five minutes of the run of months: real processes over real Zenoh, faults at random; nothing grows or contradicts."""

import subprocess

import pytest

from benchmarks.endurance import FAULTS, Outcome, Size, endure


@pytest.mark.heavy
def test_nothing_grows_and_no_grid_is_contradicted() -> None:
    """A gait that walks on, a node that records and keeps a journal, two planners and a viewer, and every fault."""
    outcome = endure(5.0, 8.0, seed=1)
    assert set(outcome.faults) == set(FAULTS)
    assert outcome.counts["new maps"] > 0 and outcome.counts["footprint handed out"] > 0
    assert outcome.counts["contradictions"] == outcome.counts["out of order"] == outcome.counts["walks that ended"] == 0
    assert outcome.sizes.keys() == {"router", "planner", "viewer", "node"}
    assert outcome.is_flat, outcome.sizes
    assert outcome.is_bounded, (outcome.recorded, outcome.journals)
    assert outcome.restarts["goes on"] > 0
    assert outcome.counts["metrics read"] > 0
    assert outcome.counts["files recovered"] > 0 and outcome.counts["scans in files"] > 0


def test_growth_is_told() -> None:
    """Of memory, handles or threads, in any process that lives on."""
    small = Size(100.0, 20, 8)
    for larger in (Size(400.0, 20, 8), Size(100.0, 40, 8), Size(100.0, 20, 30)):
        assert not Outcome(sizes={"router": [small, small], "viewer": [small, larger]}).is_flat
    assert Outcome(sizes={"router": [small, Size(110.0, 22, 9)]}).is_flat
    with subprocess.Popen(["sleep", "60"]) as process:
        assert Size.of(process.pid).threads == 1
        process.kill()
