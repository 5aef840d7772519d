"""Ridges of bright and of dark ground, of a mono camera."""

import numpy as np
import pytest

from guara_perception.stripes.band import Band
from guara_perception.stripes.precise import extract_in_any_light


def noisy(scene: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """Picture with shot noise."""
    return (scene + random.normal(0, 1, scene.shape) * np.sqrt(0.4 + 0.12 * scene)).clip(0, 255).astype(np.uint8)


@pytest.mark.parametrize("seed", range(4))
def test_bright_ground_shows_no_more_of_a_stripe_than_dark_ground_does(seed: int) -> None:
    """Shot noise is larger on bright ground; if the brightness is known, it is not taken for a stripe."""
    random = np.random.default_rng(seed)
    scene = np.full((200, 600), 10.0)
    scene[:, 450:] = 160.0
    line = 9 * np.exp(-0.5 * ((np.arange(200)[:, None] - 60) / 1.5) ** 2) * (np.arange(600) < 440)
    profile = extract_in_any_light(Band(noisy(scene + line, random), noisy(scene, random)))
    assert np.isfinite(profile.position_px[:430]).mean() > 0.9
    assert np.isnan(profile.position_px[460:]).all() and np.isnan(profile.doubtful_px[460:]).mean() > 0.9
