"""Reading pixels of a band, and channels cut out once."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from guara_perception.stripes.band import OffRows, SharedFrame, at_rows, rows_from
from tests.thorough import examples


@given(first=st.integers(-30, 70), count=st.integers(1, 25), channels=st.sampled_from([0, 1, 3]))
@settings(max_examples=examples(60), deadline=None, derandomize=True)
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
        np.testing.assert_array_equal(rows.channel(channel), plane[first:end])
        np.testing.assert_array_equal(OffRows(frame[first:end]).channel(channel), plane[first:end])
        assert np.shares_memory(rows.channel(channel), shared.channel(channel))
