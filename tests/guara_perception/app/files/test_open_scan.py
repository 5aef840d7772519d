"""Selection of one of several scans of a recording by its step."""

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
    """The message lists the steps and how to select one."""
    steps, wanted, expected_text = CASES[case]
    monkeypatch.setattr(
        module, "open_scans", lambda _, missing_ok=False: [SimpleNamespace(step=step, epoch="") for step in steps]
    )
    with pytest.raises(gp.InvalidInput) as caught:
        gp.open_scan(Path("walk.mcap"), wanted)
    assert expected_text in str(caught.value)


def test_of_a_pause_with_two_scans_the_later_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    """A coarse scan is superseded by the complete scan of the same pause."""
    scans = [SimpleNamespace(step=4, epoch="", mode=mode) for mode in ("coarse", "standard")]
    monkeypatch.setattr(module, "open_scans", lambda _, missing_ok=False: scans)
    assert gp.open_scan("walk.mcap").mode == "standard"


@pytest.mark.parametrize("step", [None, 4])
def test_a_step_of_two_walks_is_ambiguous(monkeypatch: pytest.MonkeyPatch, step: int | None) -> None:
    """Neither walk is preferred silently; the error names both."""
    scans = [SimpleNamespace(step=4, epoch=epoch, stamp=10) for epoch in ("first", "first", "")]
    monkeypatch.setattr(module, "open_scans", lambda _, missing_ok=False: scans)
    with pytest.raises(gp.InvalidInput, match=r"walk.mcap: step 4 is in 2 walks: 'first', unnamed \(scan at 10 ns\)"):
        gp.open_scan("walk.mcap", step)


def test_steps_that_begin_anew_belong_to_another_walk() -> None:
    """The later scan of each pause, also if a gait without epochs restarts its step count."""
    scans = [SimpleNamespace(step=step, epoch="") for step in (0, 1, 1, 2, 0, 1)]
    assert module.last_of_each_pause(scans) == [scans[number] for number in (0, 2, 3, 4, 5)]
