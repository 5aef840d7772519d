"""One picture of laser light from a pair: channel, fusing, clipping."""

from __future__ import annotations

import numpy as np
import pytest

from guara_perception.stripes.band import OffRows, StripeStatus
from guara_perception.stripes.extract import extract_stripe
from guara_perception.stripes.laser_light import clipped_columns, difference, fused_light, judge, laser_light


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
    assert signal.channel == channel and signal.background is not None
    np.testing.assert_array_equal(signal.frame[:, :, signal.channel], on[:, :, channel])
    np.testing.assert_array_equal(signal.background[:, :, signal.channel], off[:, :, channel])
    np.testing.assert_array_equal(signal.light, on[:, :, channel].astype(int) - off[:, :, channel])


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_pictures_that_lie_in_one_piece_are_not_copied(kind: type[np.unsignedinteger]) -> None:
    """Of a picture cut out of a wider one the channel is copied; the stripe found is the same."""
    random = np.random.default_rng(1)
    wide = random.integers(40, 60, (2, 60, 400, 3)).astype(kind)
    wide[1, 28:32, :, 1] += kind(150)
    wide[1, 29:31, 100:130, 1] = np.iinfo(kind).max
    cut_off, cut_on = wide[:, :, 40:360]
    off, on = cut_off.copy(), cut_on.copy()
    whole, cut = laser_light(on, OffRows(off)), laser_light(cut_on, OffRows(cut_off))
    assert whole.background is not None and cut.background is not None
    assert np.shares_memory(whole.frame, on) and np.shares_memory(whole.background, off)
    np.testing.assert_array_equal(whole.frame[:, :, 1], cut.frame)
    np.testing.assert_array_equal(whole.background[:, :, 1], cut.background)
    assert (whole.channel, cut.channel) == (1, 0)
    first, second = (extract_stripe(*pictures) for pictures in ((on, off), (cut_on, cut_off)))
    assert (first.status == StripeStatus.OK).any()
    for name in ("position_px", "sigma_px", "status", "peak", "doubtful_px"):
        assert getattr(first, name).tobytes() == getattr(second, name).tobytes(), name


def test_fused_light_gives_less_to_a_clipped_channel() -> None:
    """With red clipped at the core, the fused profile still has a single peak, at the centre."""
    rows = np.arange(40)[:, None]
    core = np.exp(-0.5 * ((rows - 20) / 3.0) ** 2) * np.ones((1, 64))
    off = np.full((40, 64, 3), 120, np.uint8)
    on = np.clip(off + core[:, :, None] * (60, 90, 600), 0, 255).astype(np.uint8)
    fused = fused_light(on, off, 2)
    assert (fused.argmax(axis=0) == 20).all()
    assert (on[:, 0, 2] == 255).sum() > 5


def test_clipped_cores_and_those_that_are_lost() -> None:
    """A core clipped in one channel is still used; a core that is white over five sigmas in all of them is lost."""
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
def test_some_columns_show_channel_clipping_and_swapped_frames(level: float, is_clipped: bool) -> None:
    """The channel of the line, whether its core is clipped there, and whether on and off were exchanged."""
    rows = np.arange(80)[:, None]
    line = np.exp(-0.5 * ((rows - 40.3) / 1.7) ** 2) * np.ones((1, 320))
    off = np.full((80, 320, 3), 30, np.uint8)
    on = np.clip(off + line[:, :, None] * (0.1 * level, 0.1 * level, level), 0, 255).astype(np.uint8)
    seen = judge(on, off)
    assert seen.channel == 2 and not seen.is_swapped
    assert seen.is_core_clipped == is_clipped
    assert judge(off, on).is_swapped


@pytest.mark.parametrize(("change", "is_uneven"), [(0.0, False), (8.0, True), (-8.0, True)])
def test_only_the_surroundings_tell_of_another_exposure(change: float, is_uneven: bool) -> None:
    """The light of a bright, broad stripe in a low band does not count, brightness of the surroundings does."""
    rows = np.arange(60)[:, None]
    line = np.exp(-0.5 * ((rows - 30.3) / 1.7) ** 2) * np.ones((1, 320))
    off = np.full((60, 320, 3), 40, np.uint8)
    on = (off + change + line[:, :, None] * (10.0, 10.0, 120.0)).astype(np.uint8)
    assert judge(on, off).is_uneven == is_uneven
    assert (on.astype(float) - off).mean(axis=(0, 1)).max() > 255 / 64 or is_uneven
