"""One of several scans of a recording is chosen by its step."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest

import guara_perception as gp
from guara_perception.app.files import open_scan as module

CASES = {
    "not chosen": ((0, 1, 2), None, "walk.mcap: contains scans of steps 0 ... 2; select one with --step"),
    "not there": ((1, 3), 2, "walk.mcap: no scan of step 2; contains scans of steps 1, 3; select one"),
    "none": ((), None, "walk.mcap: contains no scan"),
}


@pytest.mark.parametrize("case", CASES)
def test_which_scan_must_be_said(monkeypatch: pytest.MonkeyPatch, case: str) -> None:
    """The steps that there are, and how to choose."""
    steps, wanted, expected_text = CASES[case]
    monkeypatch.setattr(
        module, "open_scans", lambda _, missing_ok=False: [SimpleNamespace(step=step) for step in steps]
    )
    with pytest.raises(gp.InvalidInput) as caught:
        gp.open_scan(Path("walk.mcap"), wanted)
    assert expected_text in str(caught.value)


def test_of_a_pause_with_two_scans_the_later_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    """The coarse scan, and the same scan with the stripes in between."""
    scans = [SimpleNamespace(step=4, mode="coarse"), SimpleNamespace(step=4, mode="standard")]
    monkeypatch.setattr(module, "open_scans", lambda _, missing_ok=False: scans)
    assert gp.open_scan("walk.mcap").mode == "standard"
