"""The precise method on stripes whose position is known: it is right, and makes nothing up, whatever the picture."""

from __future__ import annotations

import re

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import guara_perception as gp
from guara_perception.stripes.kernel.library import addresses
from testbed.synthetic_stripes import CASES, figures
from tests.guara_perception.stripes.kernel_parts import part
from tests.thorough import examples

ROWS, COLUMNS = 96, 200
STATUS = gp.StripeStatus


def picture(
    rows: npt.ArrayLike,
    peak: npt.ArrayLike = 120.0,
    *,
    sigma: float = 1.7,
    ambient: float = 30.0,
    noise: float = 1.0,
    colour: tuple[float, float, float] = (0.05, 0.08, 1.0),
    seed: int = 0,
) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint8]]:
    """On and off frame, BGR, of a Gaussian stripe centred at `rows` (one per column; NaN = no stripe)."""
    random = np.random.default_rng(seed)
    centre = np.broadcast_to(np.asarray(rows, float), (COLUMNS,))
    distance = np.arange(ROWS)[:, None] - np.nan_to_num(centre, nan=-1e3)
    light = np.asarray(peak) * np.exp(-0.5 * (distance / sigma) ** 2)
    on = ambient + light[:, :, None] * colour + random.normal(0, noise, (ROWS, COLUMNS, 3))
    off = ambient + random.normal(0, noise, (ROWS, COLUMNS, 3))
    return tuple(np.clip(np.rint(p), 0, 255).astype(np.uint8) for p in (on, off))  # type: ignore[return-value]


def mean_error(profile: gp.StripeProfile, rows: npt.ArrayLike) -> float:
    return float(np.nanmean(np.abs(profile.position_px - np.broadcast_to(rows, (profile.position_px.size,)))))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("case", "most_error", "most_missed"), [("clean", 0.03, 0.0), ("saturated", 0.03, 0.0), ("dim", 0.13, 0.2)]
)
def test_synthetic_stripes_are_found_to_a_fraction_of_a_pixel(case: str, most_error: float, most_missed: float) -> None:
    """Clean, clipped and dim stripes with jumps and gaps: small error, nothing missed, gaps stay gaps."""
    found = figures(next(c for c in CASES if c.name == case), "precise", count=6)
    assert found["mean"] <= most_error
    assert found["missed"] <= most_missed
    assert found["false"] <= 0.5


@given(shift=st.floats(0, 1), slope=st.floats(-0.15, 0.15), sigma=st.floats(1.2, 3.5))
@settings(max_examples=examples(25), deadline=None, derandomize=True)
def test_any_sub_pixel_position_slope_and_width(shift: float, slope: float, sigma: float) -> None:
    """The centre follows the truth without a bias towards whole pixels."""
    rows = 45 + shift + slope * (np.arange(COLUMNS) - COLUMNS / 2)
    profile = gp.extract_stripe(*picture(rows, sigma=sigma))
    error = profile.position_px - rows
    assert np.isfinite(error).all()
    assert np.abs(error).mean() < 0.05
    assert abs(error.mean()) < 0.02


def test_sigma_is_no_smaller_than_the_error() -> None:
    """The stated sigma covers the error of a dim stripe and does not overstate it tenfold."""
    rows = np.full(COLUMNS, 50.3)
    profile = gp.extract_stripe(*picture(rows, 30.0, noise=4.0))
    ratio = np.sqrt(np.nanmean(((profile.position_px - rows) / profile.sigma_px) ** 2))
    assert 0.1 < ratio < 1.3


def test_a_gap_stays_a_gap() -> None:
    """Columns without a stripe are dropouts, also when the stripe beside them is bright and leaves a faint halo."""
    rows = np.full(COLUMNS, 40.0)
    on, off = picture(rows, np.where(np.arange(COLUMNS) // 50 == 1, 3.0, 200.0))
    profile = gp.extract_stripe(on, off)
    inside = slice(53, 97)
    assert (profile.status[inside] == STATUS.DROPOUT).all()
    assert np.isnan(profile.position_px[inside]).all()
    assert np.isfinite(profile.position_px[:48]).all() and np.isfinite(profile.position_px[103:]).all()


def test_faint_ghost_is_not_followed() -> None:
    """A second, weaker line (a second bounce) changes nothing."""
    on, off = picture(np.full(COLUMNS, 30.0))
    ghost, _ = picture(np.full(COLUMNS, 70.0), 30.0)
    both = np.clip(on.astype(int) + ghost - 30, 0, 255).astype(np.uint8)
    profile = gp.extract_stripe(both, off)
    assert mean_error(profile, 30.0) < 0.05
    assert (profile.status == STATUS.OK).all()


def test_two_equal_stripes_are_ambiguous() -> None:
    """Where two lines are alike over the whole picture no one can tell which is the stripe."""
    on, off = picture(np.full(COLUMNS, 25.0))
    second, _ = picture(np.full(COLUMNS, 75.0))
    both = np.clip(on.astype(int) + second - 30, 0, 255).astype(np.uint8)
    profile = gp.extract_stripe(both, off)
    assert (profile.status == STATUS.AMBIGUOUS).mean() > 0.95
    assert np.isnan(profile.position_px[profile.status == STATUS.AMBIGUOUS]).all()
    assert np.isfinite(profile.doubtful_px[profile.status == STATUS.AMBIGUOUS]).all()


def test_a_brighter_patch_beside_the_stripe_does_not_draw_it_away() -> None:
    """A short bright spot off the line is passed by: the stripe goes on where it was, or is given up."""
    on, off = picture(np.full(COLUMNS, 60.0), 90.0)
    spot, _ = picture(np.full(COLUMNS, 25.0), np.where(abs(np.arange(COLUMNS) - 100) < 4, 130.0, 0.0))
    both = np.clip(on.astype(int) + spot - 30, 0, 255).astype(np.uint8)
    profile = gp.extract_stripe(both, off)
    found = np.isfinite(profile.position_px)
    assert found.mean() > 0.8
    np.testing.assert_allclose(profile.position_px[found], 60.0, atol=0.3)


@pytest.mark.parametrize("colour", [(1.0, 0.1, 0.05), (0.1, 1.0, 0.1), (0.05, 0.08, 1.0)])
def test_any_colour_of_line(colour: tuple[float, float, float]) -> None:
    """Blue, green and red lines are found alike."""
    rows = np.full(COLUMNS, 41.4)
    assert mean_error(gp.extract_stripe(*picture(rows, colour=colour)), rows) < 0.03


def test_white_core_uses_all_channels() -> None:
    """A line that clips red in its core and in the background is found by what green and blue add."""
    rows = np.full(COLUMNS, 50.6)
    on, off = picture(rows, 500.0, ambient=150.0, colour=(0.15, 0.15, 1.0), sigma=2.5)
    profile = gp.extract_stripe(on, off)
    assert (profile.status == STATUS.SATURATED).mean() > 0.9
    assert mean_error(profile, rows) < 0.05


def test_core_clipped_in_every_channel_beyond_repair_is_ambiguous() -> None:
    """A core that is white over many rows has no centre that could be measured."""
    on, off = picture(np.full(COLUMNS, 50.0), 60.0)
    on[35:66] = 255
    assert set(gp.extract_stripe(on, off).status) <= {STATUS.AMBIGUOUS, STATUS.DROPOUT}


def test_mono_and_16_bit_pictures() -> None:
    """One channel, an axis of one channel, and 16 bits give the same positions as 8 bits of colour."""
    rows = 40 + 3 * np.sin(np.arange(COLUMNS) / 30)
    on, off = picture(rows, noise=0.5)
    colour = gp.extract_stripe(on, off)
    mono = gp.extract_stripe(on[:, :, 2], off[:, :, 2])
    single = gp.extract_stripe(on[:, :, 2:], off[:, :, 2:])
    deep = gp.extract_stripe(on.astype(np.uint16) * 257, off.astype(np.uint16) * 257)
    np.testing.assert_allclose(mono.position_px, colour.position_px, atol=1e-5)
    np.testing.assert_allclose(single.position_px, colour.position_px, atol=1e-5)
    np.testing.assert_allclose(deep.position_px, colour.position_px, atol=0.03)


def test_stripes_along_rows() -> None:
    """The transposed picture along rows gives the transposed answer."""
    rows = 50 + 0.1 * np.arange(COLUMNS)
    on, off = picture(rows)
    upright = gp.extract_stripe(on, off)
    lying = gp.extract_stripe(on.swapaxes(0, 1), off.swapaxes(0, 1), along="rows")
    np.testing.assert_array_equal(lying.position_px, upright.position_px)
    np.testing.assert_array_equal(lying.status, upright.status)


@pytest.mark.parametrize("method", ["precise", "paper"])
def test_band_gives_full_picture_rows(method: str) -> None:
    """A band finds the same stripe in the same coordinates."""
    rows = np.full(COLUMNS, 61.7)
    on, off = picture(rows)
    whole = gp.extract_stripe(on, off, method=method)
    band = gp.extract_stripe(on, off, band=(40, 88), method=method)
    np.testing.assert_allclose(band.position_px, whole.position_px, atol=0.05)


def test_without_off_frame() -> None:
    """The background is estimated from the picture itself: a smooth one costs little."""
    rows = np.full(COLUMNS, 33.3)
    on, _ = picture(rows)
    shaded = np.clip(on + np.linspace(0, 60, ROWS)[:, None, None], 0, 255).astype(np.uint8)
    assert mean_error(gp.extract_stripe(shaded), rows) < 0.15


def test_stripe_at_the_edge_of_the_band_is_out_of_band() -> None:
    """A peak on the first rows may be the flank of a stripe outside: it has no position."""
    on, off = picture(np.full(COLUMNS, 20.0))
    profile = gp.extract_stripe(on, off, band=(20, 60))
    assert (profile.status == STATUS.OUT_OF_BAND).mean() > 0.9
    assert np.isnan(profile.position_px[profile.status == STATUS.OUT_OF_BAND]).all()


def test_surface_brighter_on_one_side_raises_sigma() -> None:
    """Where the reflectance changes across the stripe the centre may be pulled over, and sigma says so."""
    rows = np.full(COLUMNS, 48.0)
    on, off = picture(rows, noise=0.5)
    shade = np.where(np.arange(ROWS) < 48, 0.5, 1.5)[:, None, None]
    steep = gp.extract_stripe((on * shade).clip(0, 255).astype(np.uint8), (off * shade).astype(np.uint8))
    assert np.nanmean(steep.sigma_px) > 2 * np.nanmean(gp.extract_stripe(on, off).sigma_px)


def test_laser_that_stayed_off_gives_no_return() -> None:
    """Two pictures of the same dark scene: every column is a dropout, nothing is made up."""
    _, off = picture(np.full(COLUMNS, 40.0), seed=1)
    _, again = picture(np.full(COLUMNS, 40.0), seed=2)
    profile = gp.extract_stripe(again, off)
    assert np.isfinite(profile.position_px).mean() < 0.01


def test_swapped_frames_are_recognised() -> None:
    """On and off exchanged: the frame is bad and says why."""
    on, off = picture(np.full(COLUMNS, 40.0))
    profile = gp.extract_stripe(off, on)
    assert profile.is_frame_bad
    assert "swapped" in profile.reason


def test_ambient_light_that_changed_is_recognised() -> None:
    """A room light switched on between the two pictures, and by how much.

    The paper's method refuses the frame; the precise one finds the stripe as if there were no laser-off picture.
    """
    on, off = picture(np.full(COLUMNS, 40.0))
    lit = (on * 1.0 + 80).clip(0, 255).astype(np.uint8)
    profile = gp.extract_stripe(lit, off, method="paper")
    assert profile.is_frame_bad
    assert "+80 of 255" in profile.reason
    profile, alone = gp.extract_stripe(lit, off), gp.extract_stripe(lit)
    assert "+80 of 255" in profile.remark and not profile.reason
    np.testing.assert_array_equal(profile.position_px, alone.position_px)
    assert mean_error(profile, 40.0) < 0.1


def test_a_laser_off_picture_of_less_use_is_told() -> None:
    """Exposed half as long, it is scaled; of another scene, it is not used, and the stripe is still found."""
    on, off = picture(np.full(COLUMNS, 40.0), peak=90.0)
    rng = np.random.default_rng(3)
    # Contrast like that of a scene, so that the exposures can be compared.
    scene = np.repeat(np.repeat(rng.uniform(0, 50, (ROWS // 8, COLUMNS // 10, 1)), 8, axis=0), 10, axis=1)
    other = np.repeat(np.repeat(rng.uniform(0, 50, (ROWS // 8, COLUMNS // 10, 1)), 8, axis=0), 10, axis=1)
    bright = (on + scene).clip(0, 255).astype(np.uint8)
    alone = gp.extract_stripe(bright)
    for dark, expected_text, most_px in (
        (0.5 * (off + scene), r"laser-off picture is 0\.5\d times as bright as the laser-on one", 0.03),
        (off + other, "another scene", 0.0),
    ):
        profile = gp.extract_stripe(bright, dark.clip(0, 255).astype(np.uint8))
        assert re.search(expected_text, profile.remark), profile.remark
        known = np.isfinite(profile.position_px)
        assert known.mean() > 0.95
        assert np.abs(profile.position_px - alone.position_px)[known].max() <= most_px
    assert gp.extract_stripe(bright, (off + scene).clip(0, 255).astype(np.uint8)).remark == ""


def test_result_is_frozen_and_of_the_promised_types() -> None:
    """float32 and uint8 arrays that nobody can write."""
    profile = gp.extract_stripe(*picture(np.full(COLUMNS, 40.0)))
    assert profile.position_px.dtype == profile.sigma_px.dtype == np.float32
    assert profile.status.dtype == np.uint8
    with pytest.raises(ValueError, match="read-only"):
        profile.position_px[0] = 1


def follow_candidates(rows: np.ndarray, heights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Chosen candidate of each column, -1 for none, and cost margin of the next best choice; of arrays (k, n)."""
    count, n = rows.shape
    rows, heights = np.ascontiguousarray(rows.T, np.int64), np.ascontiguousarray(heights.T, np.float32)
    choice, margin, costs = np.empty(n, np.int64), np.empty(n), np.empty((n, 15))
    part("follow_candidates")(*addresses(rows, heights), n, count, *addresses(costs, choice, margin))
    return choice, margin


def test_path_goes_straight_on_past_a_brighter_spot() -> None:
    """The path does not jump to another peak and back where that is higher in one column only."""
    rows = np.tile([[20], [50]], (1, 9))
    heights = np.tile(np.array([[100.0], [0.0]], np.float32), (1, 9))
    heights[:, 4] = 80, 100
    choice, margin = follow_candidates(rows, heights)
    np.testing.assert_array_equal(choice, 0)
    assert (margin > 0).all()


def test_path_may_jump_at_an_edge() -> None:
    """Where the peaks end in one row and go on in another, the path follows: an occluding edge breaks a stripe."""
    rows = np.tile([[20], [50]], (1, 10))
    heights = np.zeros((2, 10), np.float32)
    heights[0, :5], heights[1, 5:] = 100, 100
    choice, _ = follow_candidates(rows, heights)
    np.testing.assert_array_equal(choice, [0] * 5 + [1] * 5)


def test_columns_without_a_peak_have_no_stripe() -> None:
    """The path goes on after them."""
    heights = np.array([[100, 100, 0, 0, 100, 100]], np.float32)
    choice, _ = follow_candidates(np.full((1, 6), 30), heights)
    np.testing.assert_array_equal(choice, [0, 0, -1, -1, 0, 0])


def test_a_stray_peak_far_from_the_stripe_is_left_out() -> None:
    """A column whose only peak is weak and far from the stripe on both sides is a dropout."""
    rows = np.array([[20, 20, 20, 300, 20, 20, 20], [300] * 7])
    heights = np.array([[100, 100, 100, 0, 100, 100, 100], [0, 0, 0, 100, 0, 0, 0]], np.float32)
    choice, _ = follow_candidates(rows, heights)
    np.testing.assert_array_equal(choice, [0, 0, 0, -1, 0, 0, 0])


def test_two_equal_paths_have_no_margin() -> None:
    """Two rows of equal peaks: the second best path costs the same."""
    _, margin = follow_candidates(np.tile([[20], [50]], (1, 8)), np.full((2, 8), 70, np.float32))
    np.testing.assert_allclose(margin, 0, atol=1e-9)
