"""Tests of the small form of arrays: round trips, bytes by hand, cut, damaged and hostile frames."""

import numpy as np
import pytest
import zstandard
from hypothesis import given
from hypothesis import strategies as st

from transport import MessageError
from transport.messages.shuffle import compress, decompress


@given(st.binary(max_size=2000), st.integers(1, 9))
def test_what_was_compressed_comes_back(data: bytes, itemsize: int) -> None:
    assert decompress(compress(data, itemsize), itemsize) == data


@pytest.mark.parametrize("kind", [bytes, bytearray, memoryview])
def test_any_kind_of_bytes_is_taken(kind: type) -> None:
    assert decompress(kind(compress(kind(b"abcdefgh")))) == b"abcdefgh"


def test_bytes_of_one_significance_lie_side_by_side_and_the_rest_at_the_end() -> None:
    plain = zstandard.ZstdDecompressor().decompress(compress(b"ABCDabcd1234xyz"))
    assert plain == b"Aa1Bb2Cc3Dd4xyz"


def test_heights_become_smaller_than_without_the_shuffle() -> None:
    heights = np.linspace(0.0, 0.05, 10_000) + np.random.default_rng(3).normal(0.0, 1e-5, 10_000)
    data = heights.astype(np.float32).tobytes()
    assert len(compress(data)) < 0.8 * len(compress(data, 1))


def test_a_cut_frame_is_refused_wherever_it_ends() -> None:
    frame = compress(np.arange(500, dtype=np.float32).tobytes())
    for length in range(len(frame)):
        with pytest.raises(MessageError):
            decompress(frame[:length])


def test_a_flipped_bit_is_noticed() -> None:
    # Four bits of the frame's header are not used: a flip there may pass when the data are right.
    data = np.arange(300, dtype=np.float32).tobytes()
    frame = compress(data)
    refused = 0
    for index in range(8 * len(frame)):
        damaged = bytearray(frame)
        damaged[index // 8] ^= 1 << index % 8
        try:
            assert decompress(damaged) == data
        except MessageError:
            refused += 1
    assert refused > 8 * len(frame) - 8


@pytest.mark.parametrize(
    ("frame", "expected_text"),
    [
        (b"", "not a complete zstd frame"),
        (b"\x00\x01\x00\x00 a CDR message", "not a complete zstd frame"),
        (compress(b"abcd") + b"x", "not a complete zstd frame"),
        (compress(bytes(5000)), "5000 bytes refused; allowed: up to 4096 bytes"),
        (b"".join((c := zstandard.ZstdCompressor().compressobj(), [c.compress(b"abcd"), c.flush()])[1]), "its length"),
    ],
)
def test_what_is_no_frame_or_too_large_is_refused_in_words(frame: bytes, expected_text: str) -> None:
    with pytest.raises(MessageError, match=expected_text):
        decompress(frame, maximum=4096)
