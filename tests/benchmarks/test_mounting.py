"""The table of the mount: what is calibrated away costs nothing, what moves afterwards does."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import mounting
from tests import scenes

pytestmark = pytest.mark.heavy


@pytest.fixture(scope="module")
def recording() -> scenes.Recording:
    return scenes.recorded(mounting.SCAN)


def test_no_change_costs_nothing(recording: scenes.Recording) -> None:
    same = mounting.changed(recording.calibration, mounting.Change("none"))
    right = mounting.heights(recording, recording.calibration)
    error = mounting.heights(recording, same) - right
    assert np.nanmax(np.abs(error)) < 1e-6


def test_a_shift_of_everything_upwards_is_a_shift_of_heights(recording: scenes.Recording) -> None:
    """Laser and camera together up by 1 mm: every height rises by 1 mm."""
    change = mounting.Change("up", shift=(0.0, 0.0, 0.001), camera_shift=0.001)
    right = mounting.heights(recording, recording.calibration)
    error = mounting.heights(recording, mounting.changed(recording.calibration, change)) - right
    assert np.nanmedian(error) == pytest.approx(0.001, abs=2e-4)
