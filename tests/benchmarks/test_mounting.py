"""The table of the mount: what is calibrated away costs nothing, what moves afterwards does."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import mounting
from testbed import scenes

pytestmark = pytest.mark.heavy


@pytest.fixture(scope="module")
def scan() -> scenes.ScanInMemory:
    return scenes.recorded(mounting.SCAN)


def test_no_change_costs_nothing(scan: scenes.ScanInMemory) -> None:
    same = mounting.changed(scan.calibration, mounting.Change("none"))
    right = mounting.heights(scan, scan.calibration)
    error = mounting.heights(scan, same) - right
    assert np.nanmax(np.abs(error)) < 1e-6


def test_a_shift_of_everything_upwards_is_a_shift_of_heights(scan: scenes.ScanInMemory) -> None:
    """Laser and camera 1 mm further up, and a calibration that knows it: each height is 1 mm higher."""
    change = mounting.Change("up", shift=(0.0, 0.0, 0.001), camera_shift=0.001)
    right = mounting.heights(scan, scan.calibration)
    difference = mounting.heights(scan, mounting.changed(scan.calibration, change)) - right
    assert np.nanmedian(difference) == pytest.approx(0.001, abs=2e-4)


def test_the_table_has_the_sign_that_a_robot_would_see(
    scan: scenes.ScanInMemory, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Camera and laser higher than the calibration says: the ground is farther below, so heights come out too low."""
    change = mounting.Change("up", shift=(0.0, 0.0, 0.001), camera_shift=0.001)
    monkeypatch.setattr(mounting, "CHANGES", (change,))
    ((name, error, scatter),) = mounting.measure(scan)
    assert (name, error) == ("up", pytest.approx(-0.001, abs=2e-4)) and 0 <= scatter < 1e-3
