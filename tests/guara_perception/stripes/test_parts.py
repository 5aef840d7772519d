"""The parts of the precise method: peaks, paths, centres, smoothing, channels, background."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from guara_perception.stripes.background import SweepBackground
from guara_perception.stripes.centre import centres, noise_gain, responses, stripe_sigma
from guara_perception.stripes.channels import OffRows, SharedFrame
from guara_perception.stripes.clipped import clipped_columns
from guara_perception.stripes.filters import SCALE, smooth_light, smooth_wide, sums_of_columns
from guara_perception.stripes.judge import judge
from guara_perception.stripes.middle import middle, middles, spread
from guara_perception.stripes.path import follow
from guara_perception.stripes.peaks import candidates, highest_peaks
from guara_perception.stripes.signal import difference, fused_light, laser_light
from guara_perception.stripes.smooth_line import smooth_line
from guara_perception.stripes.windows import at_rows, rows_from


def gaussian(centre: float, sigma: float, rows: int = 60, columns: int = 5) -> np.ndarray:
    line = 100 * np.exp(-0.5 * ((np.arange(rows) - centre) / sigma) ** 2)
    return np.tile(line[:, None], (1, columns)).astype(np.float32)


@given(rows=st.integers(8, 70), seed=st.integers(0, 1000))
@settings(max_examples=40, deadline=None, derandomize=True)
def test_highest_peak_is_the_argmax_whatever_the_number_of_rows(rows: int, seed: int) -> None:
    """Taking maxima of blocks first changes nothing."""
    picture = np.random.default_rng(seed).integers(-500, 500, (rows, 17)).astype(np.int16)
    peaks = highest_peaks(picture.copy())
    np.testing.assert_array_equal(peaks.height, picture.max(axis=0))
    np.testing.assert_array_equal(picture[peaks.top, np.arange(17)], picture.max(axis=0))
    assert (peaks.second <= peaks.height).all()


def test_candidates_are_local_maxima_in_order_of_height() -> None:
    """Three humps give three candidates; what is below the threshold or too near gives none."""
    column = gaussian(10, 1.5) + 0.6 * gaussian(30, 1.5) + 0.3 * gaussian(50, 1.5) + 0.1 * gaussian(20, 1.5)
    rows, heights = candidates(column, np.array([2, 4]), threshold=20.0, distance=6)
    np.testing.assert_array_equal(rows[:3], [[10, 10], [30, 30], [50, 50]])
    np.testing.assert_allclose(heights[:, 0], [100, 60, 30, 0], atol=0.5)


def test_path_goes_straight_on_past_a_brighter_spot() -> None:
    """One column in which another peak is somewhat higher does not make the path jump there and back."""
    rows = np.tile([[20], [50]], (1, 9))
    heights = np.tile(np.array([[100.0], [0.0]], np.float32), (1, 9))
    heights[:, 4] = 80, 100
    choice, margin = follow(rows, heights)
    np.testing.assert_array_equal(choice, 0)
    assert (margin > 0).all()


def test_path_may_jump_at_an_edge() -> None:
    """Where one line ends and another begins the path changes over: an occlusion jump is legal."""
    rows = np.tile([[20], [50]], (1, 10))
    heights = np.zeros((2, 10), np.float32)
    heights[0, :5], heights[1, 5:] = 100, 100
    choice, _ = follow(rows, heights)
    np.testing.assert_array_equal(choice, [0] * 5 + [1] * 5)


def test_path_says_dropout_where_there_is_only_a_stray_peak() -> None:
    """Columns without any candidate have no stripe."""
    heights = np.array([[100, 100, 0, 0, 100, 100]], np.float32)
    choice, _ = follow(np.full((1, 6), 30), heights)
    np.testing.assert_array_equal(choice, [0, 0, -1, -1, 0, 0])


def test_two_equal_paths_have_no_margin() -> None:
    """Two lines alike: the second best path costs the same."""
    _, margin = follow(np.tile([[20], [50]], (1, 8)), np.full((2, 8), 70, np.float32))
    np.testing.assert_allclose(margin, 0, atol=1e-9)


def centred(light: np.ndarray, top: np.ndarray, sigma: float) -> tuple[np.ndarray, np.ndarray]:
    """Rows of the centres about these tops, and their standard deviation for noise of one grey level."""
    from_top, slope = centres(responses(light, top, np.arange(top.size), sigma))
    return top + from_top, noise_gain(sigma) / slope


@given(centre=st.floats(28.6, 31.4), sigma=st.floats(1.0, 4.0), background=st.floats(-50, 50))
@settings(max_examples=60, deadline=None, derandomize=True)
def test_centre_of_a_gaussian_on_a_constant_background(centre: float, sigma: float, background: float) -> None:
    """The filter finds the middle of any symmetrical line, and a constant background does not move it."""
    light = gaussian(centre, sigma) + np.float32(background)
    top = np.full(5, int(round(centre)))
    rows, noise = centred(light, top, round(sigma, 1))
    np.testing.assert_allclose(rows, centre, atol=0.02)
    assert (noise > 0).all()


def test_centre_of_a_clipped_line_is_the_middle_of_its_plateau() -> None:
    """A clipped core is symmetrical: its shoulders give the centre."""
    light = np.minimum(gaussian(30.4, 3.0), 40)
    rows, _ = centred(light, np.full(5, 30), 3.0)
    np.testing.assert_allclose(rows, 30.4, atol=0.05)


def test_noise_of_a_centre_is_that_of_monte_carlo() -> None:
    """The stated standard deviation per grey level is what noise of one grey level does."""
    random = np.random.default_rng(5)
    n = 4000
    light = gaussian(30.2, 2.0, columns=n) + random.normal(0, 2.0, (60, n)).astype(np.float32)
    rows, per_level = centred(light, np.full(n, 30), 2.0)
    assert np.std(rows) == pytest.approx(2.0 * float(np.median(per_level)), rel=0.1)


@pytest.mark.parametrize("sigma", [1.5, 2.5, 4.0])
def test_width_of_the_stripe(sigma: float) -> None:
    """The width above half the peak gives the sigma back, to the whole pixel that it is counted in."""
    light = gaussian(30.0, sigma)
    found = stripe_sigma(light, np.full(5, 30), np.arange(5), light.max(axis=0))
    assert found == pytest.approx(sigma, abs=0.45)


@given(slope=st.floats(-0.4, 0.4), offset=st.floats(0, 100), seed=st.integers(0, 99))
@settings(max_examples=30, deadline=None, derandomize=True)
def test_smoothing_leaves_a_straight_line_where_it_is(slope: float, offset: float, seed: int) -> None:
    """Pairs of neighbours with equal weight: no bias, whatever the weights."""
    rows = (offset + slope * np.arange(50)).astype(np.float32)
    weights = np.random.default_rng(seed).uniform(0.1, 10, 50).astype(np.float32)
    smooth, shrink = smooth_line(rows, weights)
    np.testing.assert_allclose(smooth, rows, atol=1e-3)
    assert (shrink <= 1 + 1e-6).all()


def test_smoothing_never_bridges_a_gap_or_a_jump() -> None:
    """A gap stays NaN, both sides of a jump stay where they are, and noise within a run shrinks."""
    rows = np.where(np.arange(60) < 30, 10.0, 30.0).astype(np.float32)
    rows[45:48] = np.nan
    smooth, _ = smooth_line(rows, np.ones(60, np.float32))
    np.testing.assert_array_equal(np.isnan(smooth), np.isnan(rows))
    np.testing.assert_allclose(smooth[np.isfinite(rows)], rows[np.isfinite(rows)], atol=1e-5)
    noisy = (20 + np.random.default_rng(0).normal(0, 0.1, 2000)).astype(np.float32)
    smooth, shrink = smooth_line(noisy, np.ones(2000, np.float32))
    assert np.std(smooth[5:-5]) == pytest.approx(0.1 * float(np.median(shrink)), rel=0.15)


def test_lines_are_smoothed_each_by_itself() -> None:
    """Several lines at once give what each gives alone: nothing is averaged from one line into the next."""
    random = np.random.default_rng(3)
    lines = random.normal(20, 0.2, (4, 50)).astype(np.float32)
    lines[1, 10:20] = np.nan
    weights = random.uniform(1, 9, (4, 50)).astype(np.float32)
    together = smooth_line(lines, weights)
    for place in range(4):
        for one, several in zip(smooth_line(lines[place], weights[place]), together, strict=True):
            np.testing.assert_array_equal(one, several[place])


def test_middle_and_spread() -> None:
    """The middle of an odd number of values is the median; the spread of normal noise is its sigma."""
    values = np.random.default_rng(1).normal(7, 3, 10001)
    assert middle(values) == np.median(values)
    assert spread(values) == pytest.approx(3, rel=0.05)
    rows = values[:9996].reshape(4, -1)
    np.testing.assert_array_equal(middles(rows), [middle(row) for row in rows])


def test_difference_keeps_negative_values() -> None:
    """The difference is signed: saturating at zero would halve the noise and hide swapped frames."""
    on, off = np.full((9, 9), 10, np.uint8), np.full((9, 9), 200, np.uint8)
    assert (difference(on, off) == -190).all()
    assert (difference(on.astype(np.uint16) * 257, off.astype(np.uint16) * 257) == -190 * 257).all()


@pytest.mark.parametrize("channel", [0, 1, 2])
def test_strongest_channel_is_that_of_the_line(channel: int) -> None:
    """The channel with the stripe wins, with and without an off frame; a noisy channel does not."""
    random = np.random.default_rng(channel)
    off = random.normal(50, 2, (60, 320, 3))
    off[:, :, (channel + 1) % 3] = random.normal(50, 12, (60, 320))
    on = off + random.normal(0, 2, off.shape)
    on[:, :, (channel + 1) % 3] = random.normal(50, 12, (60, 320))
    on[28:32, :, channel] += 80
    on, off = on.clip(0, 255).astype(np.uint8), off.clip(0, 255).astype(np.uint8)
    assert judge(on, off).channel == channel
    assert judge(on[:, :, channel], None).channel == 0
    signal = laser_light(on, OffRows(off))
    np.testing.assert_array_equal(signal.frame, on[:, :, channel])
    np.testing.assert_array_equal(signal.background, off[:, :, channel])
    np.testing.assert_array_equal(signal.light, on[:, :, channel].astype(int) - off[:, :, channel])


def test_fused_light_gives_less_to_a_clipped_channel() -> None:
    """With red clipped at the core, the fused profile still has a single peak in the middle."""
    rows = np.arange(40)[:, None]
    core = np.exp(-0.5 * ((rows - 20) / 3.0) ** 2) * np.ones((1, 64))
    off = np.full((40, 64, 3), 120, np.uint8)
    on = np.clip(off + core[:, :, None] * (60, 90, 600), 0, 255).astype(np.uint8)
    fused = fused_light(on, off, 2)
    assert (fused.argmax(axis=0) == 20).all()
    assert (on[:, 0, 2] == 255).sum() > 5


@given(first=st.integers(-30, 70), count=st.integers(1, 25), channels=st.sampled_from([0, 1, 3]))
@settings(max_examples=60, deadline=None, derandomize=True)
def test_windows_are_cut_at_the_edges_of_the_picture(first: int, count: int, channels: int) -> None:
    """The quick way of reading windows gives what clipped indices give, inside the picture and beyond its edges."""
    random = np.random.default_rng(count)
    shape = (50, 9) if channels == 0 else (50, 9, channels)
    picture = random.integers(0, 255, shape).astype(np.uint8)
    columns = np.array([0, 3, 8])
    starts = np.array([first, first + 2, 10])
    channel = max(channels - 1, 0)
    rows = np.clip(starts + np.arange(count)[:, None], 0, 49)
    expected = picture[rows, columns] if channels == 0 else picture[rows, columns, channel]
    np.testing.assert_array_equal(rows_from(picture, starts, count, columns, channel), expected)
    np.testing.assert_array_equal(at_rows(picture, starts, columns, channel), expected[0])


@pytest.mark.parametrize("channels", [0, 1, 3])
def test_channel_of_a_shared_frame_is_cut_out_once(channels: int) -> None:
    """Rows of a frame give the same channel whether the frame serves other stripes or not."""
    shape = (30, 12) if channels == 0 else (30, 12, channels)
    frame = np.random.default_rng(channels).integers(0, 255, shape).astype(np.uint8)
    channel = max(channels - 1, 0)
    plane = frame if channels == 0 else frame[:, :, channel]
    shared = SharedFrame(frame)
    for first, end in ((10, 25), (0, 8)):
        rows = OffRows(frame[first:end], shared, first)
        np.testing.assert_array_equal(rows.plane(channel), plane[first:end])
        np.testing.assert_array_equal(OffRows(frame[first:end]).plane(channel), plane[first:end])
        assert np.shares_memory(rows.plane(channel), shared.plane(channel))


@pytest.mark.parametrize("kind", [np.int16, np.float32])
def test_smoothing_is_the_mean_around_times_a_scale(kind: type) -> None:
    """A smoothed pixel is SCALE times the mean of its neighbourhood, and the sums of columns are of the same pixels."""
    light = np.random.default_rng(3).integers(-200, 250, (40, 60)).astype(kind)
    np.testing.assert_allclose(smooth_light(light)[20, 30], SCALE * light[19:22, 29:32].mean(), rtol=1e-5)
    assert smooth_light(np.full((20, 20), 255, kind)).max() == SCALE * 255
    np.testing.assert_allclose(smooth_wide(np.full((40, 20), 255, kind), 4.0), SCALE * 255, rtol=2e-3)
    np.testing.assert_array_equal(
        sums_of_columns(light, 8, 24)[1], [light[8, :3].sum(), light[8, 24:27].sum(), light[8, 48:51].sum()]
    )


def test_clipped_cores_and_those_that_are_lost() -> None:
    """Clipped in one channel is still of use; a core that is white over five sigmas in all of them is lost."""
    on = np.full((60, 40, 3), 40, np.uint8)
    on[28:33, :10, 2] = 255
    on[22:40, 10:20, 2] = 255
    on[22:40, 20:30] = 255
    top, sigma = np.full(40, 30), 3.0
    clipped, lost = clipped_columns(on, top, sigma, 2, is_fused=True)
    np.testing.assert_array_equal(clipped, np.arange(40) < 30)
    np.testing.assert_array_equal(lost, np.arange(40) // 10 == 2)
    _, lost_in_red = clipped_columns(on, top, sigma, 2, is_fused=False)
    np.testing.assert_array_equal(lost_in_red, np.isin(np.arange(40) // 10, (1, 2)))


@pytest.mark.parametrize(("level", "is_clipped"), [(150.0, False), (220.0, False), (900.0, True)])
def test_some_columns_tell_channel_clipping_and_swapped_frames(level: float, is_clipped: bool) -> None:
    """The channel of the line, whether its core is clipped there, and whether on and off were exchanged."""
    rows = np.arange(80)[:, None]
    line = np.exp(-0.5 * ((rows - 40.3) / 1.7) ** 2) * np.ones((1, 320))
    off = np.full((80, 320, 3), 30, np.uint8)
    on = np.clip(off + line[:, :, None] * (0.1 * level, 0.1 * level, level), 0, 255).astype(np.uint8)
    seen = judge(on, off)
    assert seen.channel == 2 and not seen.is_swapped
    assert seen.is_core_clipped == is_clipped
    assert judge(off, on).is_swapped


def sweep_frame(place: int) -> np.ndarray:
    frame = np.full((120, 64), 40, np.uint8)
    frame[10 * place + 4 : 10 * place + 7] = 200
    return frame


def test_background_of_a_sweep_is_the_darker_of_two_earlier_frames() -> None:
    """From the seventh stripe on, two frames without this stripe serve, and no other stripe is left in the minimum."""
    sweep = SweepBackground(step=2)
    for place in range(10):
        background = sweep.add(2 * place, sweep_frame(place), (0, 120))
        assert background.reason == ""
        if place < 6:
            assert background.off is None
        else:
            assert background.off is not None
            assert (background.off == 40).all()


def test_lost_frame_costs_the_stripes_that_it_would_have_served() -> None:
    """Which frames serve a stripe never changes: without one of them the stripe is given up, with the reason."""
    sweep = SweepBackground(step=1)
    reasons = {place: sweep.add(place, sweep_frame(place), (0, 120)).reason for place in range(11) if place != 4}
    assert [place for place, reason in reasons.items() if reason] == [7, 10]
    assert reasons[7] == "no laser-off frame, and frame 4, which would serve instead, was lost"


def test_frames_out_of_order_estimate_their_own_background() -> None:
    """A stripe that comes late is served by its own frame."""
    sweep = SweepBackground(step=1)
    sweep.add(9, sweep_frame(9), (0, 120))
    late = sweep.add(3, sweep_frame(3), (0, 120))
    assert (late.off, late.reason) == (None, "")
