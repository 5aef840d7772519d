"""The benchmark of slow viewers as a smoke test: every row is there, nothing fails; no time is asserted."""

import pytest

from benchmarks.viewers import RATES, measure, summary

pytestmark = pytest.mark.heavy


def test_every_kind_of_viewer_has_its_scans() -> None:
    """Two scans beside each, all answered, all grids of both extents arrived."""
    found, seen = measure(2, {})
    assert set(found) == set(RATES) and set(seen) == set(RATES) - {0.0}
    for delays in found.values():
        row = summary(delays)
        assert (row["scans"], row["failed"], len(delays["map"])) == (2, 0, 2)
        assert row["footprint_p50_ms"] <= row["footprint_p95_ms"] <= row["footprint_worst_ms"]
