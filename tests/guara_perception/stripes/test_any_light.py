"""Stripes in light in which the highest peak of a column may be something else."""

import cv2
import numpy as np
import numpy.typing as npt
import pytest

import guara_perception as gp
from tests.guara_perception.stripes.kernel_parts import follow

STATUS = gp.StripeStatus
ROWS, COLUMNS = 160, 320
LASERS = {"red": (0.15, 0.3, 1.0), "green": (0.4, 1.0, 0.35), "blue": (1.0, 0.35, 0.1)}


def scene(seed: int) -> npt.NDArray[np.float64]:
    """A chessboard in bright light, (ROWS, COLUMNS, 3), without laser."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:ROWS, :COLUMNS]
    board = 60 + 110 * (((y + 9) // 30 + x // 40) % 2)
    grey = cv2.GaussianBlur(board.astype(float), (0, 0), 1.0)
    return grey[:, :, None] * np.array([0.9, 1.0, 0.95]) + rng.normal(0, 1.5, (ROWS, COLUMNS, 3))


def line() -> npt.NDArray[np.float64]:
    """True row of the stripe in each column."""
    x = np.arange(COLUMNS)
    return 70 + 0.1 * x + 4 * np.sin(x / 40)


def laser(colour: tuple[float, float, float], contrast: float, sigma: float = 1.5) -> npt.NDArray[np.float64]:
    """Light of a line (ROWS, COLUMNS, 3)."""
    y = np.arange(ROWS)[:, None]
    return contrast * np.exp(-0.5 * ((y - line()) / sigma) ** 2)[:, :, None] * np.array(colour)


def eight_bits(light: npt.NDArray[np.float64]) -> npt.NDArray[np.uint8]:
    """Picture as a camera of 8 bits delivers it."""
    return np.clip(np.rint(light), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("colour", LASERS)
def test_a_weak_line_on_a_bright_chessboard_is_found_in_any_colour(colour: str) -> None:
    """The edges of the board have twice the line's contrast; the line is found by its colour, which is not given."""
    profile = gp.extract_stripe(eight_bits(scene(1) + laser(LASERS[colour], 50)))
    error = np.abs(profile.position_px - line())
    found = np.isfinite(error)
    assert found.mean() > 0.9
    assert (error[found] < 1).mean() > 0.99


def test_exposure_that_drifted_between_off_and_on_is_fitted() -> None:
    """In the plain difference of the two pictures the board is stronger than the laser."""
    gains = np.array([0.8, 1.25, 1.2])
    profile = gp.extract_stripe(eight_bits(scene(2) * gains + laser(LASERS["red"], 60)), eight_bits(scene(3)))
    error = np.abs(profile.position_px - line())
    found = np.isfinite(error)
    assert found.mean() > 0.9
    assert (error[found] < 1).mean() > 0.99


@pytest.mark.parametrize("sigma", [0.8, 2.0, 5.0])
def test_a_clipped_core_of_any_width_is_centred(sigma: float) -> None:
    """The core is white, the rim has the laser's colour."""
    profile = gp.extract_stripe(eight_bits(0.3 * scene(4) + laser((0.5, 0.5, 1.0), 700, sigma)))
    error = np.abs(profile.position_px - line())
    found = np.isfinite(error)
    assert found.mean() > 0.9
    assert (error[found] < 1).mean() > 0.99


def test_a_gap_stays_a_gap() -> None:
    """Where the laser meets nothing, no height is made up from the board's edges."""
    light = laser(LASERS["red"], 60)
    light[:, 120:200] = 0
    profile = gp.extract_stripe(eight_bits(scene(5) + light))
    assert np.isfinite(profile.position_px[124:196]).mean() < 0.1
    assert np.isfinite(profile.position_px[:110]).mean() > 0.9
    assert np.isfinite(profile.position_px[210:]).mean() > 0.9


def test_a_clipped_ridge_beside_the_path_makes_its_columns_ambiguous() -> None:
    """Stripe and reflection are both clipped white, so neither can be chosen; elsewhere no column is lost."""
    light = laser((0.5, 0.5, 1.0), 700, 2.0)
    light[:, 120:200] += np.roll(light[:, 120:200], 40, axis=0)
    profile = gp.extract_stripe(eight_bits(0.3 * scene(6) + light))
    assert (profile.status[124:196] == STATUS.AMBIGUOUS).all()
    assert np.isnan(profile.position_px[124:196]).all()
    assert (np.abs(profile.position_px - line()) < 1)[np.r_[:110, 210:COLUMNS]].mean() > 0.9


NO_STRIPE = 3


def value_of(states: tuple[int, ...], evidence: npt.NDArray[np.float32]) -> float:
    """Evidence (3, columns) along a path minus its costs; a state is the row in a column, or NO_STRIPE."""
    value = 0.0
    for before, state in zip((NO_STRIPE, *states), (*states, NO_STRIPE), strict=True):
        if state != NO_STRIPE and before != NO_STRIPE:
            value -= min(0.7 * abs(state - before), 6.0)
        elif state != before:
            value -= 4.0
    return value + sum(float(evidence[state, i]) for i, state in enumerate(states) if state != NO_STRIPE)


@pytest.mark.parametrize("columns", [1, 2, 4, 5])
def test_the_path_is_the_best_of_all(columns: int) -> None:
    """In small pictures, it is as good as the best of all possible paths."""
    rng = np.random.default_rng(6)
    for _ in range(12):
        evidence = rng.normal(0, 4, (NO_STRIPE, columns)).astype(np.float32)
        row, is_stripe, value = follow(evidence)
        assert row.shape == is_stripe.shape == (columns,)
        best = max(value_of(states, evidence) for states in np.ndindex(*(NO_STRIPE + 1,) * columns))
        found = tuple(np.where(is_stripe, row, NO_STRIPE).tolist())
        assert value == pytest.approx(best, abs=1e-4)
        assert value_of(found, evidence) == pytest.approx(best, abs=1e-4)


def test_without_a_stripe_the_row_is_that_of_the_nearest() -> None:
    """Between two pieces far apart each column has the row of the nearer one; a picture without any has no stripe."""
    evidence = np.full((60, 40), -5.0, np.float32)
    assert not follow(evidence)[1].any()
    evidence[7, :10] = evidence[50, 30:] = 9.0
    row, is_stripe, _ = follow(evidence)
    np.testing.assert_array_equal(is_stripe, np.r_[np.ones(10), np.zeros(20), np.ones(10)])
    np.testing.assert_array_equal(row, np.r_[np.full(20, 7), np.full(20, 50)])
