"""The camera model: rays and pixels are inverse, the lens does not fold, nonsense is refused."""

import dataclasses

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import guara_perception as gp
from guara_perception.calibration.calibration import BLOCK
from tests.thorough import examples

MATRIX = np.array([[590.0, 0, 323], [0, 588, 252], [0, 0, 1]])


def camera(distortion=(-0.24, 0.06, 0.001, -0.0005, 0.0)) -> gp.CameraModel:
    return gp.CameraModel((640, 512), MATRIX, np.array(distortion))


pixels = st.tuples(st.floats(0, 639), st.floats(0, 511))


@settings(max_examples=examples(60), derandomize=True)
@given(st.lists(pixels, min_size=1, max_size=20), st.floats(0.05, 20.0))
def test_rays_and_pixels_are_inverse(points: list[tuple[float, float]], depth: float):
    """A pixel's ray, at any depth, falls on the pixel again, to a thousandth of a pixel."""
    model = camera()
    rays = model.rays(points)
    assert rays.shape == (len(points), 3) and (rays[:, 2] == 1).all()
    np.testing.assert_allclose(model.project(rays * depth), points, atol=1e-3)


def test_without_distortion_it_is_a_pinhole():
    """u = fx x / z + cx, v = fy y / z + cy, by hand."""
    model = camera((0, 0, 0, 0, 0))
    np.testing.assert_allclose(model.project([[0.1, -0.2, 0.5]]), [[590 * 0.2 + 323, 588 * -0.4 + 252]])
    np.testing.assert_allclose(model.rays([[323, 252], [323 + 590, 252]]), [[0, 0, 1], [1, 0, 1]], atol=1e-9)


def test_distortion_is_that_of_brown():
    """The radial terms multiply by 1 + k1 r^2 + k2 r^4 + k3 r^6, the tangential ones are OpenCV's."""
    k1, k2, p1, p2, k3 = -0.24, 0.06, 0.001, -0.0005, 0.01
    x, y = 0.3, -0.2
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    v = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    expected = [[590 * u + 323, 588 * v + 252]]
    np.testing.assert_allclose(camera((k1, k2, p1, p2, k3)).project([[x, y, 1.0]]), expected, atol=1e-9)


def test_any_number_of_points_is_projected_as_by_opencv():
    """None, one, and more than fit into one block: what OpenCV gives, each by itself."""
    model = camera((-0.24, 0.06, 0.001, -0.0005, 0.01))
    points = np.random.default_rng(1).uniform((-0.4, -0.3, 0.9), (0.4, 0.3, 1.1), (2 * BLOCK + 7, 3))
    for n in (0, 1, BLOCK, len(points)):
        found = model.project(points[:n])
        assert found.shape == (n, 2)
        if n:
            expected = cv2.projectPoints(points[:n], np.zeros(3), np.zeros(3), model.matrix, model.distortion)[0]
            np.testing.assert_allclose(found, expected[:, 0], atol=1e-9)


def test_points_behind_the_camera_have_no_pixel():
    """Behind, in the plane of the lens, or past the fold of the lens model: NaN, never a pixel of the picture."""
    model = camera((-0.24, 0, 0, 0, 0))
    beyond = 1.05 * model.fold_radius()
    bad = model.project([[0, 0, -1], [0.1, 0, 0], [beyond, 0, 1], [50, 0, 1]])
    assert np.isnan(bad).all()
    assert np.isfinite(model.project([[0.95 * model.fold_radius(), 0, 1]])).all()


def test_fold_radius_is_where_growth_ends():
    """At the fold the distorted radius has its maximum; a lens that only stretches has none."""
    model = camera((-0.3, 0, 0, 0, 0))
    assert model.fold_radius() == pytest.approx(1 / np.sqrt(3 * 0.3), abs=0.003)
    assert camera((0.1, 0.01, 0, 0, 0)).fold_radius() == np.inf


def test_no_points_give_no_rays_and_no_pixels():
    """Empty in, empty out."""
    assert camera().rays(np.empty((0, 2))).shape == (0, 3)
    assert camera().project(np.empty((0, 3))).shape == (0, 2)


def test_arrays_are_copies_and_read_only():
    """Neither the caller's array nor the model's can change the model."""
    matrix = MATRIX.copy()
    model = gp.CameraModel((640, 512), matrix, np.zeros(5))
    matrix[0, 0] = 1
    assert model.matrix[0, 0] == 590
    for array in (model.matrix, model.distortion):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0


@pytest.mark.parametrize(
    ("change", "reported"),
    [
        ({"size": (640,)}, "camera size is (640,), it must be (width, height)"),
        ({"size": (8, 512)}, "integers from 16 to 8192 px"),
        ({"size": (10**9, 10**9)}, "camera size is (1000000000, 1000000000), it must be"),
        ({"size": (640.5, 512)}, "camera size is (640.5, 512), it must be (width, height), integers"),
        ({"size": (float("nan"), 512)}, "camera size is (nan, 512), it must be (width, height), integers"),
        ({"size": (640, float("inf"))}, "camera size is (640, inf), it must be (width, height), integers"),
        ({"matrix": np.eye(4)}, "camera matrix has shape (4, 4), it must be 3x3 and finite"),
        ({"matrix": MATRIX * np.nan}, "must be 3x3 and finite"),
        ({"matrix": -MATRIX}, "positive focal lengths and a last row of 0 0 1"),
        ({"matrix": np.diag([590.0, 588, 2])}, "last row of 0 0 1"),
        ({"matrix": MATRIX + [[0, 0.5, 0], [0, 0, 0], [0, 0, 0]]}, "camera matrix has a skew"),
        ({"matrix": MATRIX.T}, "last row of 0 0 1"),
        ({"distortion": np.zeros(4)}, "camera distortion has 4 values; 5 finite ones"),
        ({"distortion": np.full(5, np.inf)}, "5 finite ones are needed"),
    ],
)
def test_nonsense_is_refused(change: dict, reported: str):
    """Each message says what was given and what a camera needs."""
    with pytest.raises(gp.InvalidInput) as caught:
        dataclasses.replace(camera(), **change)
    assert reported in str(caught.value)
