"""Motion of images whose noise is larger than their contrast, against the motion with which they were made."""

from __future__ import annotations

import cv2
import numpy as np

from guara_perception.scanning.dim_background import dim_motions, show_other_ground

HEIGHT, WIDTH, COUNT = 96, 128, 40
HIDDEN = 30.0, 50.0


def flow_of_ground() -> np.ndarray:
    """Flow (h, w, 2, 6) of a plane that fills the image but for its upper rows, in pixels of 0.01 rad."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    x, y = (columns - WIDTH / 2) / 100.0, (rows - HEIGHT / 2) / 100.0
    near, zero = 1.0 + 0.5 * y, np.zeros_like(x)
    flow = 100.0 * np.stack(
        (
            np.stack((-near, zero, near * x, x * y, -(1 + x**2), y), axis=-1),
            np.stack((zero, -near, near * y, 1 + y**2, -x * y, -x), axis=-1),
        ),
        axis=2,
    )
    flow[:8] = np.nan
    return flow


def pictures_of(contrast: float, motions: np.ndarray, flow: np.ndarray, rng: np.random.Generator) -> list[np.ndarray]:
    """Images of a texture after motions (n, 6), with noise of sigma 9; every other one has a bright line."""
    texture = cv2.GaussianBlur(rng.normal(size=(HEIGHT + 40, WIDTH + 40)), (0, 0), 1.0)
    texture *= contrast / texture.std()
    rows, columns = np.mgrid[:HEIGHT, :WIDTH].astype(np.float32)
    pictures = []
    for number, motion in enumerate(motions):
        # A pixel shows the texture at the position of the ground before the motion.
        moved = np.nan_to_num(flow @ motion).astype(np.float32)
        at = columns - moved[..., 0] + 20, rows - moved[..., 1] + 20
        light = 30.0 + cv2.remap(texture.astype(np.float32), *at, cv2.INTER_CUBIC) + rng.normal(0.0, 9.0, rows.shape)
        if number % 2:
            light[38 + number % 5] += 100.0
        pictures.append(np.clip(np.rint(light), 0, 255).astype(np.uint8))
    return pictures


def sways(pixels: float) -> np.ndarray:
    """Motions (n, 6) of a few periods, whose rotation moves the image by some pixels at most."""
    phase = np.linspace(0.0, 9.0, COUNT)
    motions = np.zeros((COUNT, 6))
    motions[:, 3], motions[:, 4] = 0.01 * pixels * np.sin(phase), 0.005 * pixels * np.sin(0.7 * phase)
    motions[:, 2] = 0.004 * pixels * np.sin(0.7 * phase)
    return motions


def test_motion_is_found_where_noise_is_three_times_the_contrast() -> None:
    """Errors are below two sigmas, also for images with a hidden line; one sigma is a tenth of a pixel."""
    flow = flow_of_ground()
    hidden = [HIDDEN if number % 2 else (0.0, 0.0) for number in range(COUNT)]
    # Motion of the image in the middle [px].
    middle = flow[HEIGHT // 2, WIDTH // 2]
    for pixels in (0.0, 0.3, 4.0):
        motions = sways(pixels)
        found = dim_motions(pictures_of(3.0, motions, flow, np.random.default_rng(3)), hidden, flow)
        off = np.array([middle @ (motion - true) for (motion, _), true in zip(found, motions, strict=True)])
        off -= np.median(off, axis=0)
        sigma = np.array([np.sqrt(np.diag(middle @ covariance @ middle.T)) for _, covariance in found])
        assert sigma.max() < 0.12
        assert 0.6 < np.sqrt(np.mean((off / sigma) ** 2)) < 1.4, pixels


def test_without_texture_no_motion_is_given() -> None:
    """Gradients of noise give no motion, nor do too few images, or images without ground."""
    flow = flow_of_ground()
    none = [(0.0, 0.0)] * COUNT
    rng = np.random.default_rng(0)
    for contrast in (0.0, 0.3):
        assert dim_motions(pictures_of(contrast, sways(0.0), flow, rng)[::2], none[::2], flow) == []
    assert dim_motions([np.zeros((HEIGHT, WIDTH), np.uint8)] * 8, none[:8], flow) == []
    textured = pictures_of(10.0, sways(0.0), flow, rng)
    assert dim_motions(textured[:3], none[:3], flow) == []
    assert dim_motions(textured, none, np.full_like(flow, np.nan)) == []
    little = np.full_like(flow, np.nan)
    little[40, 60:62] = flow[40, 60:62]
    assert dim_motions(textured, none, little) == []


def test_an_image_whose_texture_is_hidden_is_not_sure() -> None:
    """All other images have an estimate."""
    flow = flow_of_ground()
    pictures = [each.copy() for each in pictures_of(10.0, sways(0.0), flow, np.random.default_rng(1))[::2]]
    hidden = [(0.0, 0.0)] * len(pictures)
    hidden[5] = (0.0, float(HEIGHT))
    found = dim_motions(pictures, hidden, flow)
    assert [each is None for each in found] == [number == 5 for number in range(len(found))]


def test_ground_that_is_too_far_off_to_be_aligned_is_other_ground() -> None:
    """For a camera that stands or sways a little it is the same ground; noise alone shows none."""
    flow = flow_of_ground()
    hidden = [HIDDEN if number % 2 else (0.0, 0.0) for number in range(COUNT)]
    slides = np.zeros((COUNT, 6))
    slides[:, 4] = np.linspace(0.0, 0.2, COUNT)
    for contrast, motions, is_other in ((0.0, slides, False), (3.0, sways(0.5), False), (3.0, slides, True)):
        for seed in range(5):
            pictures = pictures_of(contrast, motions, flow, np.random.default_rng(seed))
            assert show_other_ground(pictures, hidden) == is_other, (contrast, seed)
    assert not show_other_ground(pictures[:3], hidden[:3])
