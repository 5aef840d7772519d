"""Tests of the hash."""

import pytest

from transport.xxh3 import xxh3_128


@pytest.mark.parametrize(
    ("length", "expected"),
    [
        (129, 0x293E4968C4619023BD91CE7ACE4D385B),
        (200, 0x32200A52A918BEAF380142CDD5843BBD),
        (240, 0xAD46C1021B076BC704E0B5F034BEE80B),
        (241, 0xAC6C3492C3D6B45D8BEADD3A8874FE17),
        (300, 0x55DBF83207EFB80DFD9AA0F0D62E0227),
        (2048, 0xF81F6E8F418D8075ABE604813BA62ED1),
    ],
)
def test_hash_equals_the_reference_implementation(length: int, expected: int) -> None:
    """The hash of 7 i + 3 (mod 256) equals what python-xxhash (the reference in C) gives, in all branches."""
    low, high = xxh3_128(bytes((7 * i + 3) % 256 for i in range(length)))
    assert high << 64 | low == expected


def test_short_text_is_refused() -> None:
    """A text for which another rule holds is refused."""
    with pytest.raises(ValueError, match="128"):
        xxh3_128(b"short")
