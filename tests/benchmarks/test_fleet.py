"""The benchmark of many robots as a smoke test: every figure is there, every grid arrives; no time is asserted."""

from contextlib import ExitStack
from pathlib import Path

import pytest

from benchmarks.fleet import PERIOD, Fleet, bursts, measure, storm

pytestmark = pytest.mark.heavy


@pytest.mark.parametrize("is_secured", [False, True], ids=["tcp", "tls"])
def test_a_small_fleet_is_measured(tmp_path: Path, is_secured: bool) -> None:
    """Twelve robots in two processes: all pauses arrive, and after the router's restart each planner has the newest."""
    with ExitStack() as stack:
        fleet = Fleet(stack, 12, tmp_path if is_secured else None)
        # A robot publishes once if its random phase falls into this time: one of twelve surely does.
        row = measure(fleet, 0.9 * PERIOD)
        assert 1 <= row["pauses"] <= 12 and row["robots"] == 12
        for extent in ("footprint", "map"):
            assert row[f"{extent}_arrived"] + row["missed"] >= row["pauses"]
            middle, high, worst = row[f"{extent}_ms"]
            assert 0 < middle <= high <= worst
        assert row["mb_per_s"] > 0 and row["mb"][0] > 10 and row["processor"][1] > 0
        row = bursts(fleet, 1)
        assert row["map_arrived"] + row["missed"] >= 12 and row["map_ms"][1] <= row["map_ms"][2]
        back = storm(fleet)
    assert back["came"] == 12 and 0 <= back["newest_p50_s"] <= back["newest_worst_s"]
