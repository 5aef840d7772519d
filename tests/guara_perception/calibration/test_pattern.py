"""Stripes derived from other stripes."""

import dataclasses

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.calibration.height_sigma import HeightUncertainty
from guara_perception.calibration.mirror_model import nominal_mirror
from guara_perception.calibration.pattern import interpolate_pattern, step_errors
from guara_perception.calibration.result import CalibrationResult
from guara_perception.exceptions import CalibrationMismatch, FileFormatError

INDICES = np.arange(70)
ANGLES = -0.1 + 0.0063 * INDICES
WAVE = 9e-5 * np.sin(2 * np.pi * INDICES / 8 + 0.4)


def standard(calibration: gp.Calibration, indices: np.ndarray) -> gp.Calibration:
    """A calibration of an ideal mirror whose stepper has a periodic error."""
    mirror = nominal_mirror(np.array([0.0, 0.1, 0.05]))
    planes = mirror.planes(ANGLES + WAVE)
    record = {
        **mirror.to_dict(),
        "step_errors": [{"index": int(i), "error": float(WAVE[i])} for i in indices],
    }
    stripes = tuple(gp.StripePlane(int(i), float(ANGLES[i]), planes[i]) for i in indices)
    return dataclasses.replace(calibration, stripes=stripes, mirror=record, covariance=None)


def test_a_mirror_without_step_errors_is_told(calibration: gp.Calibration) -> None:
    mirror = {**dict(standard(calibration, INDICES[::2]).mirror or {}), "step_errors": []}
    damaged = dataclasses.replace(standard(calibration, INDICES[::2]), mirror=mirror)
    with pytest.raises(FileFormatError, match=r"step_errors is empty; allowed: the error of each calibrated stripe"):
        interpolate_pattern(damaged, range(70))


def test_standard_from_coarse_and_back(calibration: gp.Calibration) -> None:
    """Every second stripe and the motor's wave give the others exactly; without these it is the coarse one again."""
    whole = standard(calibration, INDICES)
    coarse = standard(calibration, INDICES[::2])
    derived = interpolate_pattern(coarse, range(70))
    for found, true in zip(derived.stripes, whole.stripes, strict=True):
        assert found.mirror_angle == pytest.approx(true.mirror_angle, abs=1e-12)
        np.testing.assert_allclose(found.plane, true.plane, atol=1e-9)
    assert derived.mirror is not None and derived.mirror["filled_in"] == list(range(1, 70, 2))
    again = interpolate_pattern(derived, range(0, 70, 2))
    assert again.indices == coarse.indices
    assert again.mirror is not None and again.mirror["filled_in"] == []


def test_errors_without_a_wave_are_interpolated() -> None:
    """Noise is no wave: neighbours are interpolated, and sigma says how little is known."""
    errors = np.random.default_rng(1).normal(0, 1e-4, 35)
    estimated, sigma = step_errors(np.array([1.0, 3.0]), INDICES[::2].astype(float), errors)
    np.testing.assert_allclose(estimated, [(errors[0] + errors[1]) / 2, (errors[1] + errors[2]) / 2])
    assert sigma > 1e-4


def test_derived_stripes_are_less_sure(result: CalibrationResult) -> None:
    """A stripe that was not calibrated itself has the larger covariance; the others keep theirs."""
    derived = interpolate_pattern(result.calibration, range(69))
    uncertainty = HeightUncertainty.of(derived)
    assert uncertainty is not None
    assert np.trace(uncertainty.planes[21]) > np.trace(uncertainty.planes[20])
    np.testing.assert_array_equal(uncertainty.planes[20], result.laser.uncertainty.planes[20])
    assert derived.hash == ""


def test_stripes_out_of_reach(calibration: gp.Calibration, result: CalibrationResult) -> None:
    """Stripes far outside the calibrated ones, and calibrations without a mirror model, are refused."""
    with pytest.raises(
        CalibrationMismatch, match=r"index 71, 75, 76 cannot .* 0, 2 ... 68; allowed: indices at most 2 outside"
    ):
        interpolate_pattern(result.calibration, [0, 71, 75, 76])
    with pytest.raises(CalibrationMismatch, match="has no mirror model: create it with `guara calibrate`"):
        interpolate_pattern(calibration, range(69))
    spoilt = dataclasses.replace(result.calibration, mirror={"axis": [0, 1]})
    with pytest.raises(FileFormatError, match="calibration: mirror.laser_plane is missing"):
        interpolate_pattern(spoilt, range(69))
