"""The paper's homography and stripe constants."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from guara_perception.calibration.surface_map import apply_homography, stripe_constants, surface_map
from guara_perception.exceptions import InvalidInput
from tests.thorough import examples

PIXELS = np.array([[100.0, 80.0], [1200.0, 90.0], [1000.0, 900.0], [250.0, 880.0], [640.0, 500.0]])
POINTS = np.array([[0.52, 0.25], [0.52, -0.25], [0.93, -0.25], [0.93, 0.25]])
bounded = settings(max_examples=examples(40), derandomize=True, deadline=None)


@bounded
@given(st.lists(st.floats(-1, 1), min_size=8, max_size=8), st.integers(4, 5))
def test_homography_is_recovered(noise: list[float], count: int) -> None:
    """Marks made by a homography give it back, with four marks and with more, whatever its scale."""
    scale = np.array([1e-4, 1e-4, 0.1, 1e-4, 1e-4, 0.1, 1e-5, 1e-5])
    true = np.append(np.array([1e-5, 5e-4, 0.45, -5e-4, 2e-5, 0.3, 1e-6, 3e-5]) + 0.1 * scale * noise, 1).reshape(3, 3)
    points = apply_homography(true, PIXELS[:count])
    found = surface_map(PIXELS[:count], points)
    np.testing.assert_allclose(apply_homography(found.homography, PIXELS), apply_homography(true, PIXELS), atol=1e-9)
    assert found.rms < 1e-9


def test_residual_shows_a_wrong_mark() -> None:
    """Five marks, one of them off by 10 mm, leave a residual; four cannot."""
    true = surface_map(PIXELS[:4], POINTS)
    points = apply_homography(true.homography, PIXELS)
    points[4, 0] += 0.010
    assert surface_map(PIXELS, points).rms > 0.002
    assert true.rms < 1e-12


@pytest.mark.parametrize(
    ("pixels", "points", "reason"),
    [
        (PIXELS[:3], POINTS[:3], r"four or more marks; pixels \(3, 2\)"),
        (PIXELS[:4], POINTS[:3], r"pixels \(4, 2\) and points \(3, 2\)"),
        (PIXELS[:4] * [1, 0], POINTS * [1, 0], "collinear"),
    ],
)
def test_marks_that_fix_no_map(pixels: np.ndarray, points: np.ndarray, reason: str) -> None:
    """Too few marks, unequal numbers, and marks collinear are refused."""
    with pytest.raises(InvalidInput, match=reason):
        surface_map(pixels, points)


def seen_at(height: float, camera_height: float, camera_x: float, floor_x: float, slope: float) -> float:
    """Rectified x of a laser plane x = floor_x + slope h at a height: where the camera's ray meets the floor."""
    return camera_x + (floor_x + slope * height - camera_x) * camera_height / (camera_height - height)


@bounded
@given(
    st.floats(0.5, 0.95),
    st.floats(-0.8, 0.3),
    st.lists(st.sampled_from(range(0, 160, 20)), min_size=2, max_size=5, unique=True),
)
def test_constants_are_exact(floor_x: float, slope: float, heights_mm: list[int]) -> None:
    """Eq. 18 in rectified coordinates gives every height, also those between and beyond the calibrated ones."""
    if abs(seen_at(0.1, 0.5, 0.4, floor_x, slope) - seen_at(0, 0.5, 0.4, floor_x, slope)) < 5e-3:
        return
    heights = [1e-3 * h for h in heights_mm]
    x = [seen_at(h, 0.5, 0.4, floor_x, slope) for h in heights]
    constants = stripe_constants(7, 0.5, x, heights)
    assert constants["residual"] < 1e-9
    for height in (0.0, 0.033, 0.2):
        v = seen_at(height, 0.5, 0.4, floor_x, slope)
        found = 0.5 - constants["n"] / (v * constants["d"] - constants["k"])
        assert found == pytest.approx(height, abs=1e-7)


@pytest.mark.parametrize(("x", "heights"), [([0.6], [0.0]), ([0.6, 0.6], [0.0, 0.04]), ([0.6, 0.7], [0.04, 0.04])])
def test_singular_stripes(x: list[float], heights: list[float]) -> None:
    """One height, one position or equal heights make eq. 17 singular and are refused."""
    with pytest.raises(
        InvalidInput, match="stripe index 3: two or more heights with different positions of the stripe"
    ):
        stripe_constants(3, 0.5, x, heights)
