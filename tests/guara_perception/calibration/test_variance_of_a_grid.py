"""The variance of a grid: stripe position and calibration together, and right against the truth."""

import dataclasses
from pathlib import Path

import numpy as np

import guara_perception as gp
from guara_perception.calibration.result import CalibrationResult
from kinematics import RobotModel
from testbed.grid_truth import load_truth


def test_error_over_sigma(result: CalibrationResult, paper_scan: gp.Scan, robot: RobotModel, data: Path) -> None:
    """Measured error over predicted sigma has a standard deviation near one, through our own calibration.

    The joints and the gravity of the recorded scan are exact: what they leave open is left out.
    """
    truth = load_truth(data / "scans" / "paper" / "truth.npz", 5)
    terrain = gp.process_scan(paper_scan, result.calibration, robot, pictures=False)
    used = truth.interior & np.isfinite(terrain.elevation)
    bare = dataclasses.replace(result.calibration, covariance=None)
    by_calibration = terrain.variance - gp.process_scan(paper_scan, bare, robot, pictures=False).variance
    ratio = (terrain.elevation - truth.mean)[used] / np.sqrt(terrain.variance_local + by_calibration)[used]
    assert used.sum() > 5000
    assert 0.7 < float(np.std(ratio)) < 1.5


def test_calibration_adds_variance(result: CalibrationResult, paper_scan: gp.Scan, robot: RobotModel) -> None:
    """Without the covariance of the calibration every known cell claims a smaller variance, at the same height."""
    with_it = gp.process_scan(paper_scan, result.calibration, robot, pictures=False)
    bare = dataclasses.replace(result.calibration, covariance=None)
    without = gp.process_scan(paper_scan, bare, robot, pictures=False)
    np.testing.assert_array_equal(with_it.elevation, without.elevation)
    known = np.isfinite(with_it.elevation)
    assert (with_it.layer("variance")[known] > without.layer("variance")[known]).all()
