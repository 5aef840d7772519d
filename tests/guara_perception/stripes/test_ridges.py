"""Ridges and how much of them is chance."""

import numpy as np

from guara_perception.stripes.any_light.laser_colour import ridges


def test_bright_ground_shows_no_more_of_a_stripe_than_dark_ground_does() -> None:
    """Photons make bright ground noisy; where its brightness is known, its noise is no stronger a ridge."""
    rng = np.random.default_rng(1)
    scene = np.full((200, 600), 10.0, np.float32)
    scene[:, 450:] = 160.0
    light = (rng.normal(0, 1, scene.shape) * np.sqrt(0.4 + 0.03 * scene)).astype(np.float32)

    def chance(strength: np.ndarray) -> float:
        bright, dark = (np.quantile(strength[:, columns], 0.999) for columns in (slice(460, None), slice(0, 440)))
        return float(bright / dark)

    assert chance(ridges(light).strength) > 2.5
    assert chance(ridges(light, None, scene).strength) < 1.5


def test_dark_ground_does_not_strengthen_ridges() -> None:
    """There a halo alone would then count as a stripe: ridges on dark ground are as strong as without the scene."""
    rng = np.random.default_rng(2)
    scene = np.full((200, 600), 160.0, np.float32)
    scene[:, 450:] = 10.0
    light = (rng.normal(0, 1, scene.shape) * np.sqrt(0.4 + 0.03 * scene)).astype(np.float32)
    alone, with_scene = ridges(light).strength, ridges(light, None, scene).strength
    assert (with_scene <= alone + 1e-6)[alone > 0].all()
