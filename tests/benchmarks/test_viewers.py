"""The benchmark of slow viewers as a smoke test: every row is there, nothing fails; no time is asserted."""

import pytest

from benchmarks.viewers import RATES, measure

pytestmark = pytest.mark.heavy


def test_every_kind_of_viewer_has_its_scans() -> None:
    """Two scans beside each, all answered, all grids of both extents arrived."""
    found, seen = measure(2, {})
    assert set(found) == set(RATES) and set(seen) == set(RATES) - {0.0}
    for delays in found.values():
        assert (len(delays["footprint"]), delays["failed"], len(delays["map"])) == (2, [], 2)
        assert min(delays["footprint"] + delays["map"]) > 0
