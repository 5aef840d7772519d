"""Stripes of a sweep: several at once are each found as if alone, and no background is kept that may have changed."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

import guara_perception as gp
from guara_perception.scanning.stripe_finder import StripeFinder, SweepBackground
from guara_perception.stripes.band import Band

WIDTH, HEIGHT = 160, 120
Image = npt.NDArray[np.uint8]
Banded = tuple[int, tuple[int, int], Any, Any]


def off_frame(level: float = 30.0, seed: int = 9) -> Image:
    noise = np.random.default_rng(seed).normal(0, 1, (HEIGHT, WIDTH, 3))
    return np.clip(np.rint(level + noise), 0, 255).astype(np.uint8)


def on_frame(row: float, peak: float, off: Image, seed: int) -> Image:
    line = peak * np.exp(-0.5 * ((np.arange(HEIGHT)[:, None] - row) / 1.7) ** 2) * np.ones((1, WIDTH))
    line[:, 70:80] = 0
    noise = np.random.default_rng(seed).normal(0, 1, off.shape)
    return np.clip(np.rint(off + noise + line[:, :, None] * (0.2, 0.3, 1.0)), 0, 255).astype(np.uint8)


def sweep(seed: int = 0) -> list[Banded]:
    """Stripes dim, bright, clipped and out of the band, and frames that cannot be used, with bands of many sizes."""
    random = np.random.default_rng(seed)
    frames: list[Banded] = []
    for index in range(9):
        off = off_frame(seed=index)
        row = 20.0 + 9.3 * index
        band = int(row - random.integers(15, 20)), int(row + random.integers(12, 25))
        frames.append((index, band, on_frame(row, (15.0, 90.0, 600.0)[index % 3], off, index), off))
    frames.append((9, (0, 40), np.zeros((HEIGHT, WIDTH, 3), np.uint8), off_frame()))
    frames.append((10, (0, 40), frames[1][3], frames[1][2]))
    frames.append((11, (60, 60), frames[1][2], frames[1][3]))
    frames.append((12, (0, 40), frames[1][2][:50], frames[1][3]))
    frames.append((13, (50, 90), frames[0][2], frames[0][3]))
    return frames


def find_all(finder: StripeFinder, frames: Sequence[Banded]) -> list[gp.StripeProfile]:
    """Stripes of frames that each have a band of their own."""
    return [finder.find(gp.FramePair(index, on, off), rows) for index, rows, on, off in frames]


def assert_same(one: gp.StripeProfile, other: gp.StripeProfile) -> None:
    for field in dataclasses.fields(gp.StripeProfile):
        np.testing.assert_array_equal(getattr(one, field.name), getattr(other, field.name), field.name)


def test_each_stripe_is_found_where_it_is() -> None:
    """Found in the full picture's rows, whatever the bands; what cannot be used says why."""
    found = find_all(StripeFinder("precise", (WIDTH, HEIGHT), 1), sweep())
    for index in range(9):
        error = found[index].position_px - (20.0 + 9.3 * index)
        assert np.nanmax(np.abs(error)) < 0.6 and np.isfinite(error).mean() > 0.8
        assert np.isnan(error[72:78]).all()
    assert [profile.is_frame_bad for profile in found] == [False] * 9 + [True] * 4 + [False]
    assert "blank" in found[9].reason and "swapped" in found[10].reason
    assert "outside the camera's view" in found[11].reason and "160x50 px" in found[12].reason


def test_shared_off_frame_gives_what_copies_give() -> None:
    """One laser-off frame for all of a group gives the same stripes as a copy for each."""
    off = off_frame()
    shared = [(i, (10, 60), on_frame(30.0 + i, 90.0, off, i), off) for i in range(8)]
    apart = [(*frame[:3], off.copy()) for frame in shared]
    finders = [StripeFinder("precise", (WIDTH, HEIGHT), 1) for _ in range(2)]
    for one, other in zip(*(find_all(f, of) for f, of in zip(finders, (shared, apart), strict=True)), strict=True):
        assert_same(one, other)


@pytest.mark.parametrize("count", [1, 4])
@pytest.mark.parametrize("kind", ["writable", "read-only view", "frozen"])
def test_off_buffer_that_is_used_again_is_looked_at_again(kind: str, count: int) -> None:
    """A laser-off frame that its owner overwrites between two stripes or groups, however it is handed over."""
    buffer = off_frame()
    handed = buffer.view() if kind == "read-only view" else buffer
    finder = StripeFinder("precise", (WIDTH, HEIGHT), 1)
    for seed, level in enumerate((30.0, 30.0, 30.0, 130.0)):
        buffer.setflags(write=True)
        buffer[:] = off_frame(level, seed)
        on = on_frame(40.0, 90.0, buffer, seed)
        (buffer if kind == "frozen" else handed).setflags(write=kind == "writable")
        expected = gp.extract_stripe(on, buffer, band=(20, 60))
        for found in find_all(finder, [(count * seed + i, (20, 60), on, handed) for i in range(count)]):
            assert_same(found, expected)


def test_on_buffer_that_is_used_again_serves_later_stripes_as_it_was() -> None:
    """No laser-off frames and a camera of one channel that fills the same memory again and again."""
    buffer = np.empty((HEIGHT, WIDTH), np.uint8)
    finders = [StripeFinder("precise", (WIDTH, HEIGHT), 1) for _ in range(2)]
    for index in range(9):
        row = 20.0 + 9.3 * index
        buffer[:] = on_frame(row, 90.0, off_frame(seed=index), index)[:, :, 2]
        band = int(row - 18), int(row + 20)
        again, fresh = (
            find_all(finder, [(index, band, frame, None)])[0]
            for finder, frame in zip(finders, (buffer, buffer.copy()), strict=True)
        )
        assert np.isfinite(fresh.position_px).mean() > 0.8
        assert_same(again, fresh)


def sweep_frame(number: int) -> np.ndarray:
    frame = np.full((120, 64), 40, np.uint8)
    frame[10 * number + 4 : 10 * number + 7] = 200
    return frame


def test_background_of_a_sweep_is_the_darker_of_two_earlier_frames() -> None:
    """From the seventh stripe on, two frames without this stripe serve, and no other stripe is left in the minimum."""
    sweep = SweepBackground(stride=2)
    for number in range(10):
        background = sweep.add(2 * number, sweep_frame(number), (0, 120))
        assert isinstance(background, Band)
        if number < 6:
            assert background.off is None
        else:
            assert background.off is not None
            assert (background.off == 40).all()


def test_lost_frame_costs_the_stripes_that_it_would_have_served() -> None:
    """Which frames serve a stripe never changes: without one of them the stripe is given up, with the reason."""
    sweep = SweepBackground(stride=1)
    bands = {number: sweep.add(number, sweep_frame(number), (0, 120)) for number in range(11) if number != 4}
    reasons = {number: band for number, band in bands.items() if isinstance(band, str)}
    assert list(reasons) == [7, 10]
    assert reasons[7] == (
        "no laser-off frame, and the frame of stripe 4, one of the two earlier frames that replace it, is missing or "
        "unusable"
    )


def test_frames_out_of_order_estimate_their_own_background() -> None:
    """A stripe that comes late is served by its own frame."""
    sweep = SweepBackground(stride=1)
    sweep.add(9, sweep_frame(9), (0, 120))
    late = sweep.add(3, sweep_frame(3), (0, 120))
    assert isinstance(late, Band) and late.off is None
