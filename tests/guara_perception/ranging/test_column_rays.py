"""Polynomial rays are those of the camera model, whatever the lens."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from guara_perception.calibration.camera import CameraModel
from guara_perception.ranging.column_rays import TOLERANCE_PX, ColumnRays
from tests.thorough import examples

SIZE = (320, 256)
MATRIX = np.array([[295.0, 0, 161.0], [0, 294.0, 125.0], [0, 0, 1]])


def worst_error_px(camera: CameraModel, seed: int = 0) -> float:
    """Largest difference from the exact rays at a random row of every column."""
    rows = np.random.default_rng(seed).uniform(0, SIZE[1] - 1, SIZE[0])
    exact = camera.rays(np.column_stack((np.arange(SIZE[0]), rows)))[:, :2].T
    return float(np.abs(ColumnRays(camera).at(rows) - exact).max() * MATRIX[0, 0])


@given(
    k1=st.floats(-0.26, 0.2),
    k2=st.floats(0.0, 0.08),
    p=st.tuples(st.floats(-2e-3, 2e-3), st.floats(-2e-3, 2e-3)),
    seed=st.integers(0, 1000),
)
@settings(max_examples=examples(40), deadline=None, derandomize=True)
def test_rays_are_those_of_the_camera(k1: float, k2: float, p: tuple[float, float], seed: int) -> None:
    """Any usual lens: within a few millionths of a pixel, fitted or not."""
    assert worst_error_px(CameraModel(SIZE, MATRIX, np.array([k1, k2, *p, 0.0])), seed) < 3 * TOLERANCE_PX


@pytest.mark.parametrize("k1", [0.0, -0.22, -0.6])
def test_lens_that_no_polynomial_fits_is_computed_exactly(k1: float) -> None:
    """Polynomials fit usual lenses; rays of a strong one, which folds inside the picture, are computed exactly."""
    camera = CameraModel(SIZE, MATRIX, np.array([k1, 0, 0, 0, 0]))
    rays = ColumnRays(camera)
    assert (rays._coefficients is None) == (k1 == -0.6)
    assert worst_error_px(camera) < TOLERANCE_PX


@pytest.mark.parametrize("k1", [-0.2, -0.6])
def test_chosen_columns_and_missing_rows(k1: float) -> None:
    """Rays of some columns are those among all columns; a NaN row has no ray."""
    rays = ColumnRays(CameraModel(SIZE, MATRIX, np.array([k1, 0, 0, 0, 0])))
    rows = np.linspace(100.0, 140.0, SIZE[0])
    rows[40:50] = np.nan
    every = rays.at(rows)
    assert np.isnan(every[:, 40:50]).all() and np.isfinite(np.delete(every, np.s_[40:50], axis=1)).all()
    columns = np.array([3, 39, 45, 200])
    np.testing.assert_array_equal(rays.at(rows[columns], columns), every[:, columns])
