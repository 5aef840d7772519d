"""Pieces of a path that belong to the laser, and laser-off pictures of mono cameras, which have no colour."""

import cv2
import numpy as np
import numpy.typing as npt
import pytest

import guara_perception as gp
from tests.guara_perception.stripes.kernel_parts import of_laser_speckle, strong_pieces

STATUS = gp.StripeStatus
ROWS, COLUMNS = 240, 480
STRIPE, CABLE = slice(20, 200), slice(260, 460)


def eight_bits(light: npt.NDArray[np.float64]) -> npt.NDArray[np.uint8]:
    """Picture as a camera of 8 bits delivers it."""
    return np.clip(np.rint(light), 0, 255).astype(np.uint8)


def squares(level: float) -> npt.NDArray[np.float64]:
    """A dark scene (ROWS, COLUMNS) with a few bright squares, which a laser-off picture of another exposure leaves."""
    scene = np.full((ROWS, COLUMNS), 12.0)
    for row, column in ((20, 30), (20, 150), (150, 90), (180, 300), (60, 400), (190, 420)):
        scene[row : row + 34, column : column + 40] = level
    return cv2.GaussianBlur(scene, (0, 0), 1.0)


def ridge(row: float | npt.NDArray[np.float64], sigma: float, columns: slice) -> npt.NDArray[np.float64]:
    """A ridge (ROWS, COLUMNS) of height 1 in some columns."""
    light = np.exp(-0.5 * ((np.arange(ROWS)[:, None] - row) / sigma) ** 2) * np.ones(COLUMNS)
    keep = np.zeros(COLUMNS)
    keep[columns] = 1
    return light * keep


def speckle(seed: int, contrast: float) -> npt.NDArray[np.float64]:
    """Brightness (ROWS, COLUMNS) of laser light on rough ground, 1 in the mean."""
    grain = cv2.GaussianBlur(np.random.default_rng(seed).normal(0, 1, (ROWS, COLUMNS)), (0, 0), 0.8)
    return np.maximum(1 + contrast * grain / grain.std(), 0.05)


def noise(seed: int, light: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Picture with shot noise and read noise."""
    return light + np.random.default_rng(seed).normal(0, 1, light.shape) * np.sqrt(0.5 + 0.02 * light)


@pytest.mark.parametrize("seed", range(4))
def test_a_thing_that_came_between_the_pictures_of_a_mono_camera_is_doubtful(seed: int) -> None:
    """A cable is in the laser-on picture alone, exposed longer: thin as a stripe, but smooth as ambient light."""
    dark = squares(90)
    cable = 30 * ridge(140 + 15 * np.sin(np.arange(COLUMNS) / 60), 2.0, CABLE)
    light = 40 * ridge(110, 1.5, STRIPE) * speckle(seed, 0.4)
    on, off = (eight_bits(noise(seed + i, one)) for i, one in ((10, 1.2 * dark + cable + light), (20, dark)))
    profile = gp.extract_stripe(on, off)
    assert (np.abs(profile.position_px[STRIPE] - 110) < 1).mean() > 0.9
    assert np.isnan(profile.position_px[CABLE]).all()
    assert (profile.status[CABLE] == STATUS.AMBIGUOUS).mean() > 0.8


def test_a_stripe_that_is_as_grainy_everywhere_loses_nothing() -> None:
    """The same line on nearer, wider ground: its grain shows that it is laser light."""
    light = 40 * ridge(110, 1.5, STRIPE) * speckle(1, 0.4) + 30 * ridge(140, 2.0, CABLE) * speckle(2, 0.4)
    on, off = eight_bits(noise(3, 1.2 * squares(90) + light)), eight_bits(noise(4, squares(90)))
    profile = gp.extract_stripe(on, off)
    assert np.isfinite(profile.position_px[STRIPE]).mean() > 0.9
    assert np.isfinite(profile.position_px[CABLE]).mean() > 0.9


@pytest.mark.parametrize("dim_contrast", [0.0, 0.4])
def test_a_brightest_piece_without_grain_says_nothing(dim_contrast: float) -> None:
    """A camera may be too coarse to show the grain, and a dim piece on texture is no reference."""
    rng = np.random.default_rng(5)
    bright, dim = 60 * ridge(110, 1.5, STRIPE), 20 * ridge(140, 2.0, CABLE) * speckle(6, dim_contrast)
    light = (bright + dim + rng.normal(0, 0.5, (ROWS, COLUMNS))).astype(np.float32)
    rows = np.where(np.arange(COLUMNS) < 230, 110, 140)
    is_stripe = np.zeros(COLUMNS, bool)
    is_stripe[STRIPE] = is_stripe[CABLE] = True
    assert (of_laser_speckle(light, rows, is_stripe, 2.0) == is_stripe).all()


@pytest.mark.parametrize("slope", [0.0, 0.1])
def test_a_line_that_is_drawn_has_neither_grain_nor_noise(slope: float) -> None:
    """In a mono picture without a laser-off picture, both levels of the line are found."""
    row = 60.3 + slope * np.arange(COLUMNS) + np.where(np.arange(COLUMNS) < 230, 0.0, 50.0)
    profile = gp.extract_stripe(eight_bits(10 + 180 * ridge(row, 1.6, slice(0, COLUMNS))))
    assert (profile.status == STATUS.OK).mean() > 0.95
    assert np.nanmax(np.abs(profile.position_px - row)) < 0.1


def test_the_gain_of_a_scene_that_is_mostly_dark_is_fitted() -> None:
    """Squares on an eighth of the scene stand 20 grey levels out of the plain difference, the stripe 4."""
    rows = 110 + 0.1 * np.arange(COLUMNS)
    light = 4 * ridge(rows, 1.5, slice(0, COLUMNS)) * speckle(7, 0.3)
    on, off = eight_bits(noise(8, 1.25 * squares(90) + light)), eight_bits(noise(9, squares(90)))
    profile = gp.extract_stripe(on, off)
    found = np.isfinite(profile.position_px)
    assert found.mean() > 0.9
    assert (np.abs(profile.position_px - rows)[found] < 1.5).mean() > 0.99


def test_a_piece_that_is_short_and_weak_is_no_stripe() -> None:
    """Either alone is allowed."""
    columns = np.arange(200)
    rows = np.select([columns < 100, columns < 113], [50, 20], 80)
    height = np.select([columns < 100, columns < 113], [40, 10], 12).astype(np.float32)
    good = strong_pieces(height, rows, np.ones(200, bool), 0.15)
    np.testing.assert_array_equal(good, (columns < 100) | (columns >= 113))
