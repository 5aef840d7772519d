"""XXH3 with 128 bits, seed 0, for inputs of more than 128 bytes: the hash from which rmw_zenoh makes its ids.

Written from the published description of the algorithm; slow, and used for a few short texts only. The names are the
algorithm's: a *stripe* here is a block of 64 bytes.
"""

from __future__ import annotations

import struct

MASK = 2**64 - 1
PRIME32 = (0x9E3779B1, 0x85EBCA77, 0xC2B2AE3D)
PRIME64 = (
    0x9E3779B185EBCA87,
    0xC2B2AE3D27D4EB4F,
    0x165667B19E3779F9,
    0x85EBCA77C2B2AE63,
    0x27D4EB2F165667C5,
)
SECRET = bytes.fromhex(
    "b8fe6c3923a44bbe7c01812cf721ad1cded46de9839097db7240a4a4b7b3671f"
    "cb79e64eccc0e578825ad07dccff7221b8084674f743248ee03590e6813a264c"
    "3c2852bb91c300cb88d0658b1b532ea371644897a20df94e3819ef46a9deacd8"
    "a8fa763fe39c343ff9dcbbc7c70b4f1d8a51e04bcdb45931c89f7ec9d9787364"
    "eac5ac8334d3ebc3c581a0fffa1363eb170ddd51b7f0da49d316552629d4689e"
    "2b16be587d47a1fc8ff8b8d17ad031ce45cb3a8f95160428afd7fbcabb4b407e"
)
STRIPE = 64
STRIPES_PER_BLOCK = (192 - STRIPE) // 8


def _word(data: bytes, offset: int) -> int:
    value: int = struct.unpack_from("<Q", data, offset)[0]
    return value


def _fold(a: int, b: int) -> int:
    product = a * b
    return (product & MASK) ^ (product >> 64)


def _avalanche(h: int) -> int:
    h ^= h >> 37
    h = h * 0x165667919E3779F9 & MASK
    return h ^ (h >> 32)


def _mix(data: bytes, offset: int, secret: int) -> int:
    return _fold(_word(data, offset) ^ _word(SECRET, secret), _word(data, offset + 8) ^ _word(SECRET, secret + 8))


def _up_to_240(data: bytes) -> tuple[int, int]:
    """Low and high half for 129 to 240 bytes."""

    def mix(low: int, high: int, first: int, second: int, secret: int) -> tuple[int, int]:
        low = (low + _mix(data, first, secret)) & MASK
        low ^= (_word(data, second) + _word(data, second + 8)) & MASK
        high = (high + _mix(data, second, secret + 16)) & MASK
        high ^= (_word(data, first) + _word(data, first + 8)) & MASK
        return low, high

    length = len(data)
    low, high = length * PRIME64[0] & MASK, 0
    for i in range(4):
        low, high = mix(low, high, 32 * i, 32 * i + 16, 32 * i)
    low, high = _avalanche(low), _avalanche(high)
    for i in range(4, length // 32):
        low, high = mix(low, high, 32 * i, 32 * i + 16, 3 + 32 * (i - 4))
    # The last 32 bytes, their second half first; this offset into the secret is the algorithm's.
    low, high = mix(low, high, length - 16, length - 32, 136 - 17 - 16)
    mixed = (low * PRIME64[0] + high * PRIME64[3] + length * PRIME64[1]) & MASK
    return _avalanche((low + high) & MASK), -_avalanche(mixed) & MASK


def _accumulate(lanes: list[int], data: bytes, offset: int, secret: int) -> None:
    for i in range(8):
        value = _word(data, offset + 8 * i)
        keyed = value ^ _word(SECRET, secret + 8 * i)
        lanes[i ^ 1] = (lanes[i ^ 1] + value) & MASK
        lanes[i] = (lanes[i] + (keyed & 0xFFFFFFFF) * (keyed >> 32)) & MASK


def _scramble(lanes: list[int]) -> None:
    for i in range(8):
        lane = lanes[i] ^ (lanes[i] >> 47) ^ _word(SECRET, 192 - STRIPE + 8 * i)
        lanes[i] = lane * PRIME32[0] & MASK


def _merge(lanes: list[int], secret: int, start: int) -> int:
    total = start
    for i in range(4):
        keyed = (lanes[2 * i] ^ _word(SECRET, secret + 16 * i), lanes[2 * i + 1] ^ _word(SECRET, secret + 16 * i + 8))
        total += _fold(*keyed)
    return _avalanche(total & MASK)


def _long(data: bytes) -> tuple[int, int]:
    """Low and high half for more than 240 bytes."""
    lanes = [PRIME32[2], *PRIME64[:4], PRIME32[1], PRIME64[4], PRIME32[0]]
    length = len(data)
    block = STRIPE * STRIPES_PER_BLOCK
    blocks = (length - 1) // block
    for number in range(blocks):
        for i in range(STRIPES_PER_BLOCK):
            _accumulate(lanes, data, number * block + i * STRIPE, 8 * i)
        _scramble(lanes)
    for i in range((length - 1 - block * blocks) // STRIPE):
        _accumulate(lanes, data, blocks * block + i * STRIPE, 8 * i)
    _accumulate(lanes, data, length - STRIPE, 192 - STRIPE - 7)
    low = _merge(lanes, 11, length * PRIME64[0] & MASK)
    high = _merge(lanes, 192 - STRIPE - 11, ~(length * PRIME64[1]) & MASK)
    return low, high


def xxh3_128(data: bytes) -> tuple[int, int]:
    """(low, high) 64-bit halves of the hash.

    Raises:
        ValueError: `data` has 128 bytes or fewer, for which the algorithm has another rule that is not needed here.
    """
    if len(data) <= 128:
        raise ValueError(f"text has {len(data)} bytes; this hash is made for more than 128")
    return _up_to_240(data) if len(data) <= 240 else _long(data)
