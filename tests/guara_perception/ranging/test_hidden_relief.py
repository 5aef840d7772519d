"""Relief between two stripes, predicted from the roughness along them."""

from __future__ import annotations

import numpy as np
import pytest

from tests.guara_perception.ranging import plain_run_ends as plain
from tests.guara_perception.stripes.kernel_parts import pair_relief

COLUMN_M, APART_M, WIDTH = 0.0009, 0.0162, 640
NOISE_M = 1e-4


def rough_ground(rng: np.random.Generator, x: float, y: np.ndarray, waves: np.ndarray) -> np.ndarray:
    """Heights of waves (n, 4) of wave numbers along x and y, phase and amplitude."""
    return np.asarray((waves[:, 3:] * np.sin(waves[:, :1] * x + waves[:, 1:2] * y + waves[:, 2:3])).sum(axis=0))


def stripes(heights: list[np.ndarray]) -> np.ndarray:
    y = COLUMN_M * np.arange(WIDTH)
    return np.stack([np.stack((np.full(WIDTH, k * APART_M), y, z)) for k, z in enumerate(heights)], axis=1)


@pytest.mark.parametrize("longest", [0.05, 0.15])
def test_relief_is_what_lies_between_the_stripes(longest: float) -> None:
    """Over 60 rough grounds, the ground halfway differs from the line by the predicted variance, within a fifth."""
    rng = np.random.default_rng(4)
    y = COLUMN_M * np.arange(WIDTH)
    true, predicted = [], []
    for _ in range(60):
        lengths, angles = rng.uniform(0.03, longest, 20), rng.uniform(0, 2 * np.pi, 20)
        numbers = 2 * np.pi / lengths
        waves = np.column_stack(
            (numbers * np.cos(angles), numbers * np.sin(angles), rng.uniform(0, 2 * np.pi, 20), np.full(20, 5e-4))
        )
        first, middle, last = (rough_ground(rng, x, y, waves) for x in (0.0, APART_M / 2, APART_M))
        true.append(np.mean((middle - (first + last) / 2) ** 2))
        noisy = [z + NOISE_M * rng.standard_normal(WIDTH) for z in (first, last)]
        predicted.append(pair_relief(stripes(noisy), np.full((2, WIDTH), NOISE_M**2)).mean())
    assert np.mean(predicted) == pytest.approx(np.mean(true), rel=0.2)


def test_a_plane_hides_nothing() -> None:
    """At any slope; noise of the points is subtracted, except for less than a tenth."""
    rng, y = np.random.default_rng(1), COLUMN_M * np.arange(WIDTH)
    assert pair_relief(stripes([0.3 * y, 0.01 + 0.3 * y]), np.zeros((2, WIDTH))).max() < 1e-14
    noisy = [0.3 * y + NOISE_M * rng.standard_normal(WIDTH) for _ in range(2)]
    assert np.median(pair_relief(stripes(noisy), np.full((2, WIDTH), NOISE_M**2))) < 0.1 * NOISE_M**2


def test_gaps_and_short_runs_say_nothing() -> None:
    """A step behind a gap is no roughness; runs shorter than the stripe spacing have nothing to compare with."""
    high = np.where(np.arange(WIDTH) < WIDTH // 2, 0.0, 0.03)
    high[WIDTH // 2 - 2 : WIDTH // 2 + 2] = np.nan
    assert pair_relief(stripes([high, high]), np.zeros((2, WIDTH))).max() < 1e-14
    short = np.where(np.arange(WIDTH) % 16 < 12, np.random.default_rng(0).normal(0, 1e-3, WIDTH), np.nan)
    assert not pair_relief(stripes([short, short]), np.zeros((2, WIDTH))).any()
    nothing = np.full(WIDTH, np.nan)
    assert not pair_relief(stripes([nothing, high]), np.zeros((2, WIDTH))).any()


@pytest.mark.parametrize("seed", range(5))
def test_relief_is_that_of_the_slow_reference(seed: int) -> None:
    """Rough stripes with gaps and jumps."""
    rng = np.random.default_rng(seed)
    steps = rng.choice([0.0, 0.003, 0.02, np.nan], (2, WIDTH // 40)).repeat(40, axis=1)
    points = stripes(list(steps + rng.normal(0, NOISE_M, steps.shape))).astype(np.float32)
    variance = rng.uniform(0, NOISE_M**2, steps.shape).astype(np.float32)
    np.testing.assert_allclose(pair_relief(points, variance), plain.pair_relief(points, variance), rtol=0, atol=1e-15)
