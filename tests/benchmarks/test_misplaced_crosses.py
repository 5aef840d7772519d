"""The benchmark of misplaced crosses: what it changes, and one case of it."""

from __future__ import annotations

import numpy as np
import pytest

import guara_perception as gp
from benchmarks.misplaced_crosses import CASES, DATA, effect, one_off, shifted, turned
from guara_perception.app.files.calibration_session import open_session
from guara_perception.calibration.calibrate_session import calibrate_session
from kinematics import load_robot


def test_crosses_are_misplaced_as_said() -> None:
    """A shift moves all alike, a turn keeps distances and angles, one off leaves the others."""
    points = np.array([[0.5, 0.2], [0.5, -0.2], [0.9, -0.2], [0.9, 0.2]])
    np.testing.assert_allclose(shifted(0.002, 0.0)(points) - points, [[0.002, 0.0]] * 4, atol=1e-15)
    rotated = turned(90.0)(points)
    np.testing.assert_allclose(rotated, np.column_stack((-points[:, 1], points[:, 0])), atol=1e-12)
    np.testing.assert_allclose(one_off(0.003)(points) - points, [[0.003, 0.0]] + [[0.0, 0.0]] * 3, atol=1e-15)


@pytest.mark.heavy
def test_the_grid_moves_with_the_crosses_and_heights_stay() -> None:
    """All crosses 2 mm ahead: so is the whole grid; no height changes by more than a few tenths of a millimetre."""
    session, robot = open_session(DATA / "calibration"), load_robot("guara")
    known = calibrate_session(session, robot).calibration
    scan = gp.open_scan(DATA / "scans" / "paper")
    near, far, height, scatter, verdict = effect(session, scan, robot, known, CASES["all 2 mm too far ahead"])
    assert near == pytest.approx(0.002, abs=2e-4) and far == pytest.approx(0.002, abs=2e-4)
    assert abs(height) < 2e-4 and scatter < 5e-4 and verdict == "good"
