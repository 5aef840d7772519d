"""The benchmark of sweeps: its required figures are met, in emulated time."""

from __future__ import annotations

import json

import pytest

from benchmarks import sweeps
from testbed import emulated_sweeps

pytestmark = pytest.mark.slow


def test_a_triggered_sweep_stays_near_its_bound() -> None:
    """70 stripes with 4 ms of light each: all proved, within 1.15 times the bound and within 0.65 s."""
    result = emulated_sweeps.triggered(70)
    assert result.proved == 70 and result.seconds <= min(1.15 * result.bound, 0.65)


@pytest.mark.heavy
def test_the_figures_are_json() -> None:
    """They have the promised keys, and survive JSON."""
    figures = json.loads(json.dumps(sweeps.measure(faulty_sweeps=2)))
    assert set(figures) == {"triggered", "free_running", "faults"}
    assert set(figures["triggered"]) == {"stripes", "flash_s", "seconds", "bound_s", "proved", "end_to_end_s"}
    assert [entry["fps"] for entry in figures["free_running"]] == [30, 60, 120, 200] * 2
    assert set(figures["faults"]) == {"sweeps", "injected", "found", "wrong_stripes"}
