"""Alternating scans of two checkouts: what is reported of each, and what is refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.peers import ROOT
from benchmarks.scan_cost import HERE, THERE, measure

SCANS = ROOT / "tests" / "data" / "scans"


@pytest.mark.heavy
def test_both_checkouts_scan_in_turns() -> None:
    """The same code twice: a time for each round, and their ratio."""
    timings = measure({HERE: ROOT, THERE: ROOT}, SCANS / "paper", rounds=2)
    for name in (HERE, THERE):
        assert set(timings.seconds[name]) == {0, 1} and timings.milliseconds(name) > 0
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
