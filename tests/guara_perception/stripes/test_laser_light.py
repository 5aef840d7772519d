"""Judgement of a frame pair by some of its columns: channel, exposure, clipping."""

from __future__ import annotations

import numpy as np
import pytest

from guara_perception.stripes.band import clearest_channel
from guara_perception.stripes.kernel.library import Picture, addresses
from tests.guara_perception.stripes.kernel_parts import judge, part


@pytest.mark.parametrize("channel", [0, 1, 2])
def test_strongest_channel_is_that_of_the_line(channel: int) -> None:
    """The channel with the stripe wins, with and without an off frame, with any strides; a noisy channel does not."""
    random = np.random.default_rng(channel)
    off = random.normal(50, 2, (60, 320, 3))
    off[:, :, (channel + 1) % 3] = random.normal(50, 12, (60, 320))
    on = off + random.normal(0, 2, off.shape)
    on[:, :, (channel + 1) % 3] = random.normal(50, 12, (60, 320))
    on[28:32, :, channel] += 80
    on, off = on.clip(0, 255).astype(np.uint8), off.clip(0, 255).astype(np.uint8)
    assert judge(on, off).channel == channel
    assert judge(on[:, :, channel], None).channel == 0
    assert clearest_channel(on) == judge(on, None).channel
    for strips in (np.s_[:, :, :], np.s_[::-1, ::-1], np.s_[:, ::2]):
        assert judge(on[strips], off[strips]).channel == channel


def test_a_pair_that_is_none_is_refused() -> None:
    """The check comes before the kernel reads beyond the smaller picture."""
    on = np.zeros((20, 30, 3), np.uint8)
    for off in (on[:19], on[:, :, 0], on.astype(np.uint16)):
        with pytest.raises(ValueError, match="allowed: uint8 \\(20, 30, 3\\)"):
            judge(on, off)
    with pytest.raises(ValueError, match="float64"):
        judge(on.astype(float), None)


def test_clipped_cores_and_those_that_are_lost() -> None:
    """A core clipped in one channel is still used; a core that is white over five sigmas in all of them is lost."""
    on = np.full((60, 40, 3), 40, np.uint8)
    on[28:33, :10, 2] = 255
    on[22:40, 10:20, 2] = 255
    on[22:40, 20:30] = 255
    top, sigma = np.full(40, 30), 3.0

    def clipped_and_lost(*, is_fused: bool) -> np.ndarray:
        masks = np.empty((2, 40), np.bool_)
        part("clipped_columns")(Picture(on), *addresses(top), sigma, 2, is_fused, *addresses(*masks))
        return masks

    clipped, lost = clipped_and_lost(is_fused=True)
    np.testing.assert_array_equal(clipped, np.arange(40) < 30)
    np.testing.assert_array_equal(lost, np.arange(40) // 10 == 2)
    _, lost_in_red = clipped_and_lost(is_fused=False)
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
