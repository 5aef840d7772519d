"""The peaks of a band, and the smoothing before them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from guara_perception.stripes.kernel.library import address
from tests.guara_perception.stripes.kernel_parts import part
from tests.guara_perception.stripes.plain_light import (
    SCALE,
    noise_gain,
    noise_of_columns,
    responses,
    robust_sigma,
    smooth_bins,
    smooth_light,
    stripe_sigma,
)
from tests.thorough import examples


def gaussian(centre: float, sigma: float, rows: int = 60, columns: int = 5) -> np.ndarray:
    line = 100 * np.exp(-0.5 * ((np.arange(rows) - centre) / sigma) ** 2)
    return np.tile(line[:, None], (1, columns)).astype(np.float32)


@pytest.mark.parametrize("kind", [np.int16, np.float32])
def test_smoothing_is_the_mean_around_times_a_scale(kind: type) -> None:
    """A smoothed pixel is SCALE times the mean of its neighbourhood; noise is that of sums of as many columns."""
    light = np.random.default_rng(3).integers(-200, 250, (40, 60)).astype(kind)
    np.testing.assert_allclose(smooth_light(light)[20, 30], SCALE * light[19:22, 29:32].mean(), rtol=1e-5)
    assert smooth_light(np.full((20, 20), 255, kind)).max() == SCALE * 255
    np.testing.assert_allclose(smooth_bins(np.full((40, 20), 255, kind), 4.0), SCALE * 255, rtol=1e-5)
    sums = np.array([[light[row, column : column + 3].sum() for column in (0, 24, 48)] for row in range(0, 40, 8)])
    assert noise_of_columns(light) == pytest.approx(robust_sigma(sums), rel=1e-6)


def centred(light: np.ndarray, top: np.ndarray, sigma: float) -> tuple[np.ndarray, np.ndarray]:
    """Rows of the centres about these tops, and their standard deviation for noise of one grey level."""
    response = responses(light, top, sigma)
    from_top, slope = np.empty((2, top.size), np.float32)
    part("centres")(address(response), top.size, address(from_top), address(slope))
    return top + from_top, noise_gain(sigma) / slope


@given(centre=st.floats(28.6, 31.4), sigma=st.floats(1.0, 4.0), background=st.floats(-50, 50))
@settings(max_examples=examples(60), deadline=None, derandomize=True)
def test_centre_of_a_gaussian_on_a_constant_background(centre: float, sigma: float, background: float) -> None:
    """The filter finds the centre, and a constant background does not move it."""
    light = gaussian(centre, sigma) + np.float32(background)
    top = np.full(5, int(round(centre)))
    rows, noise = centred(light, top, round(sigma, 1))
    np.testing.assert_allclose(rows, centre, atol=0.02)
    assert (noise > 0).all()


def test_centre_of_a_clipped_stripe_is_that_of_its_plateau() -> None:
    """A clipped core is symmetrical: its shoulders give the centre."""
    light = np.minimum(gaussian(30.4, 3.0), 40)
    rows, _ = centred(light, np.full(5, 30), 3.0)
    np.testing.assert_allclose(rows, 30.4, atol=0.05)


def test_noise_of_a_centre_is_that_of_monte_carlo() -> None:
    """The predicted standard deviation equals that of centres with one grey level of noise."""
    random = np.random.default_rng(5)
    n = 4000
    light = gaussian(30.2, 2.0, columns=n) + random.normal(0, 2.0, (60, n)).astype(np.float32)
    rows, per_level = centred(light, np.full(n, 30), 2.0)
    assert np.std(rows) == pytest.approx(2.0 * float(np.median(per_level)), rel=0.1)


@pytest.mark.parametrize("sigma", [1.5, 2.5, 4.0])
def test_width_of_the_stripe(sigma: float) -> None:
    """The width above half the peak gives the sigma back, as well as a width in whole pixels can."""
    light = gaussian(30.0, sigma)
    found = stripe_sigma(light, np.full(5, 30), np.arange(5), light.max(axis=0))
    assert found == pytest.approx(sigma, abs=0.45)
