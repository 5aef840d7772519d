"""Alternating scans of two checkouts: what is reported of each, and what is refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.scan_cost import HERE, ROOT, THERE, Cost, measure

SCANS = ROOT / "tests" / "data" / "scans"


@pytest.mark.heavy
def test_both_checkouts_scan_in_turns_and_tell_how_their_stripes_were_found() -> None:
    """The same code twice: the same stripes by the same paths, a time for each round."""
    costs, timings = measure({HERE: ROOT, THERE: ROOT}, SCANS / "paper", rounds=2)
    for name in (HERE, THERE):
        assert costs[name].stripes == 35
        assert costs[name].strong == 0, "clean frames need no second path"
        assert 0 < costs[name].cheap_ms < costs[name].scan_ms
        assert set(timings.seconds[name]) == {0, 1}
    assert timings.ratio(HERE, THERE).median > 0


def test_a_folder_without_a_checkout_is_refused(tmp_path: Path) -> None:
    """Its path is named."""
    with pytest.raises(SystemExit, match=f"{tmp_path}: no checkout of guara_perception; allowed: its root folder"):
        measure({HERE: tmp_path}, SCANS / "paper", rounds=1)


@pytest.mark.heavy
def test_a_scan_that_is_not_there_is_reported(tmp_path: Path) -> None:
    """The process that ends is named by its checkout; nothing hangs."""
    with pytest.raises(SystemExit, match="the scan with the code of .* failed"):
        measure({HERE: ROOT}, tmp_path / "scans" / "none", rounds=1)


def test_the_share_of_each_path_is_printed() -> None:
    """A time in any light only where stripes were followed in it."""
    nan = float("nan")
    both = "3 of 30 stripes (10%) in any light; 1.00 ms a stripe by its highest peaks, 40.0 ms one in any light"
    assert str(Cost(100.0, 30, 3, 1.0, 40.0)) == f"   100 ms a scan, {both}"
    assert str(Cost(100.0, 30, 0, 1.0, nan)).endswith("1.00 ms a stripe by its highest peaks")
