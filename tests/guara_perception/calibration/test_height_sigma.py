"""Height uncertainty of a calibration: propagation by Monte Carlo, JSON form, refusals."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.calibration.calibration import plane_in_frame
from guara_perception.calibration.height_sigma import FIELD_TERMS, HeightUncertainty, field_covariance, field_terms
from guara_perception.calibration.mirror_model import nominal_mirror
from guara_perception.calibration.result import CalibrationResult
from guara_perception.calibration.row_bands import row_bands
from guara_perception.calibration.stripe_planes import moved_plane, plane_basis
from guara_perception.exceptions import FileFormatError
from kinematics import RobotModel

MARGIN = 8
HEIGHTS = np.array([-0.085, 0.145])


def test_plane_variance_by_monte_carlo() -> None:
    """The variance of heights equals that of random planes met by the same rays, at several positions and heights."""
    random = np.random.default_rng(3)
    mirror = nominal_mirror(np.array([0.2, 0.0, -0.03]))
    plane = mirror.planes([0.2])[0]
    basis = plane_basis(plane, mirror)
    covariance = np.diag([2e-4, 3e-5, 1e-4]) ** 2
    uncertainty = HeightUncertainty({4: basis.T @ covariance @ basis}, np.zeros(3), np.zeros((10, 10)))
    height, y = np.array([-0.5, -0.42, -0.4]), np.array([-0.2, 0.0, 0.25])
    points = np.column_stack((-(plane[2] * height + plane[3]) / plane[0], y, height))
    predicted = uncertainty.variance([4], plane[None], points.T[:, None], np.eye(4), np.eye(4))[0]
    heights = []
    for change in random.multivariate_normal(np.zeros(3), covariance, 4000):
        moved = moved_plane(plane, basis, change)
        heights.append(points[:, 2] * -moved[3] / (points @ moved[:3]))
    np.testing.assert_allclose(np.std(heights, axis=0), np.sqrt(predicted), rtol=0.06)


def test_field_covariance_by_monte_carlo() -> None:
    """A field that is linear in two correlated parameters has the variance of its samples everywhere."""
    random = np.random.default_rng(5)
    offsets = random.uniform(-0.2, 0.2, (60, 3))
    effects = random.normal(size=(10, 2))
    parameters = np.array([[4.0, 1.0], [1.0, 2.0]]) * 1e-8
    errors = [field_terms(offsets.T).T @ effect for effect in effects.T]
    covariance = field_covariance(offsets, errors, parameters)
    terms = field_terms(np.array([[0.1], [-0.05], [0.02]])).T
    samples = random.multivariate_normal(np.zeros(2), parameters, 20000) @ (terms @ effects)[0]
    assert np.var(samples) == pytest.approx(float((terms @ covariance @ terms.T)[0, 0]), rel=0.04)


def test_unknown_points_stay_unknown(result: CalibrationResult) -> None:
    """A NaN point has a NaN variance, its neighbours do not; a stripe between two takes its neighbour's plane."""
    uncertainty = HeightUncertainty.of(result.calibration)
    assert uncertainty is not None
    pose = result.transform_base_to_footprint @ result.calibration.transform_camera_to_base
    points = np.array([[0.7, 0.0, 0.0], [np.nan, np.nan, np.nan]])
    mount = result.calibration.transform_camera_to_base
    planes = np.array([result.calibration.stripe(34).plane] * 2)
    both = np.stack((points.T, points.T), axis=1)
    at_34, at_33 = uncertainty.variance([34, 33], planes, both, pose, mount)
    assert 0 < at_34[0] < (0.5e-3) ** 2
    assert np.isnan(at_34[1])
    assert at_33[0] > 0


def test_stripes_together_are_the_stripes_alone(result: CalibrationResult) -> None:
    """Variances of several stripes computed together equal those of each stripe alone, bit for bit."""
    uncertainty = HeightUncertainty.of(result.calibration)
    assert uncertainty is not None
    pose = result.transform_base_to_footprint @ result.calibration.transform_camera_to_base
    mount = result.calibration.transform_camera_to_base
    indices = (0, 10, 34, 35, 69)
    planes = np.array([result.calibration.stripe(index - index % 2).plane for index in indices])
    points = np.random.default_rng(2).uniform(-0.3, 0.3, (3, len(indices), 101)) + np.array([0.7, 0, 0])[:, None, None]
    points[:, 2, 40:50] = np.nan
    together = uncertainty.variance(indices, planes, points, pose, mount)
    for k, index in enumerate(indices):
        alone = uncertainty.variance([index], planes[k : k + 1], points[:, k : k + 1], pose, mount)
        np.testing.assert_array_equal(together[k], alone[0])


def test_json_form(result: CalibrationResult) -> None:
    """What is stored is read back as it was."""
    stored = HeightUncertainty.of(result.calibration)
    assert stored is not None
    expected = result.laser.uncertainty
    assert stored.planes.keys() == expected.planes.keys()
    np.testing.assert_array_equal(stored.planes[20], expected.planes[20])
    np.testing.assert_array_equal(stored.field, expected.field)


def test_calibration_without_covariance(calibration: gp.Calibration) -> None:
    """A nominal calibration has no uncertainty."""
    assert HeightUncertainty.of(calibration) is None


def broken(covariance: dict[str, Any], change: str) -> dict[str, Any]:
    """Covariance with one invalid field."""
    field = dict(covariance["height_field"])
    if change == "terms":
        return {**covariance, "height_field": {**field, "terms": list(FIELD_TERMS[:9])}}
    if change == "matrix":
        return {**covariance, "height_field": {**field, "matrix": [[1.0]]}}
    if change == "no stripes":
        return {**covariance, "stripes": []}
    return {name: value for name, value in covariance.items() if name != "stripes"}


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ("terms", "height_field.terms must be 1, x, y"),
        ("matrix", "calibration: covariance.height_field.matrix has shape 1x1; it must be 10x10"),
        ("stripes", "calibration: covariance.stripes is missing"),
        ("no stripes", "calibration: covariance.stripes is empty; allowed: the plane of each calibrated stripe"),
    ],
)
def test_spoilt_covariance(result: CalibrationResult, change: str, reason: str) -> None:
    """An invalid field of a covariance edited by hand is named."""
    covariance = broken(dict(result.calibration.covariance or {}), change)
    with pytest.raises(FileFormatError, match=reason):
        HeightUncertainty.of(dataclasses.replace(result.calibration, covariance=covariance))


@pytest.fixture(scope="module")
def transform(calibration: gp.Calibration, robot: RobotModel, paper_scan: gp.Scan) -> np.ndarray:
    """Camera to footprint."""
    pose = robot.stance_pose(paper_scan.stance).transform_base_to_footprint
    return np.asarray(pose @ calibration.transform_camera_to_base)


@pytest.mark.parametrize("index", [0, 9, 20, 34])
def test_a_band_holds_all_rows_of_its_laser_plane(
    calibration: gp.Calibration, transform: np.ndarray, index: int
) -> None:
    """Against points set densely on the lines in which the laser plane crosses each height."""
    plane = calibration.stripes[index].plane
    (first, end), *_ = row_bands(calibration.camera, transform, plane[None], HEIGHTS, MARGIN)
    a, b, c, d = plane_in_frame(plane, transform)
    y = np.linspace(-0.6, 0.6, 40_001)
    rows = []
    for height in HEIGHTS:
        points = np.column_stack((-(b * y + c * height + d) / a, y, np.full(y.size, height)))
        u, v = calibration.camera.project((points - transform[:3, 3]) @ transform[:3, :3]).T
        rows.append(v[(u >= 0) & (u <= calibration.camera.size[0] - 1)])
    lowest, highest = min(map(np.min, rows)), max(map(np.max, rows))
    # Lines bend between the samples that the band is made from by no more than a tenth of a pixel.
    assert first == max(np.floor(lowest) - MARGIN, 0) or abs(lowest - round(lowest)) < 0.1
    assert end == min(np.ceil(highest) + MARGIN + 1, calibration.camera.size[1]) or abs(highest - round(highest)) < 0.1


def test_a_band_does_not_depend_on_the_other_laser_planes(calibration: gp.Calibration, transform: np.ndarray) -> None:
    """Asked for together or one by one; every laser plane of the pattern has a band."""
    planes = np.array([stripe.plane for stripe in calibration.stripes])
    together = row_bands(calibration.camera, transform, planes, HEIGHTS, MARGIN)
    assert together == [row_bands(calibration.camera, transform, p[None], HEIGHTS, MARGIN)[0] for p in planes]
    assert all(end - first > 2 * MARGIN for first, end in together)


def test_a_laser_plane_out_of_view_has_no_band(calibration: gp.Calibration, transform: np.ndarray) -> None:
    """Far ahead of the picture, and behind the camera."""
    to_camera = np.linalg.inv(transform)
    upright = np.array([[1.0, 0.0, 0.0, -far] for far in (5.0, -5.0)])
    planes = plane_in_frame(upright, to_camera)
    assert row_bands(calibration.camera, transform, planes, HEIGHTS, MARGIN) == [(0, 0), (0, 0)]
    assert row_bands(calibration.camera, transform, planes[:0], HEIGHTS, MARGIN) == []
