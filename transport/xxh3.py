"""XXH3 with 128 bits, seed 0, for texts of more than 128 bytes: the hash from which rmw_zenoh makes its ids.

Written from the published description of the algorithm; slow, and used for a handful of short texts only.
"""

import struct
from typing import Final

_MASK: Final = 2**64 - 1
_PRIME32: Final = (0x9E3779B1, 0x85EBCA77, 0xC2B2AE3D)
_PRIME64: Final = (
    0x9E3779B185EBCA87,
    0xC2B2AE3D27D4EB4F,
    0x165667B19E3779F9,
    0x85EBCA77C2B2AE63,
    0x27D4EB2F165667C5,
)
_SECRET: Final = bytes.fromhex(
    "b8fe6c3923a44bbe7c01812cf721ad1cded46de9839097db7240a4a4b7b3671f"
    "cb79e64eccc0e578825ad07dccff7221b8084674f743248ee03590e6813a264c"
    "3c2852bb91c300cb88d0658b1b532ea371644897a20df94e3819ef46a9deacd8"
    "a8fa763fe39c343ff9dcbbc7c70b4f1d8a51e04bcdb45931c89f7ec9d9787364"
    "eac5ac8334d3ebc3c581a0fffa1363eb170ddd51b7f0da49d316552629d4689e"
    "2b16be587d47a1fc8ff8b8d17ad031ce45cb3a8f95160428afd7fbcabb4b407e"
)
_STRIPE: Final = 64
_STRIPES_PER_BLOCK: Final = (192 - _STRIPE) // 8


def _word(data: bytes, offset: int) -> int:
    value: int = struct.unpack_from("<Q", data, offset)[0]
    return value


def _fold(a: int, b: int) -> int:
    product = a * b
    return (product & _MASK) ^ (product >> 64)


def _avalanche(h: int) -> int:
    h ^= h >> 37
    h = h * 0x165667919E3779F9 & _MASK
    return h ^ (h >> 32)


def _mix(data: bytes, offset: int, secret: int) -> int:
    return _fold(_word(data, offset) ^ _word(_SECRET, secret), _word(data, offset + 8) ^ _word(_SECRET, secret + 8))


def _middle(data: bytes) -> tuple[int, int]:
    """Low and high half for 129 to 240 bytes."""

    def step(low: int, high: int, first: int, second: int, secret: int) -> tuple[int, int]:
        low = (low + _mix(data, first, secret)) & _MASK
        low ^= (_word(data, second) + _word(data, second + 8)) & _MASK
        high = (high + _mix(data, second, secret + 16)) & _MASK
        high ^= (_word(data, first) + _word(data, first + 8)) & _MASK
        return low, high

    length = len(data)
    low, high = length * _PRIME64[0] & _MASK, 0
    for i in range(4):
        low, high = step(low, high, 32 * i, 32 * i + 16, 32 * i)
    low, high = _avalanche(low), _avalanche(high)
    for i in range(4, length // 32):
        low, high = step(low, high, 32 * i, 32 * i + 16, 3 + 32 * (i - 4))
    # The tail is read from the end, second half first, with the secret taken near its 136th byte.
    low, high = step(low, high, length - 16, length - 32, 136 - 17 - 16)
    mixed = (low * _PRIME64[0] + high * _PRIME64[3] + length * _PRIME64[1]) & _MASK
    return _avalanche((low + high) & _MASK), -_avalanche(mixed) & _MASK


def _accumulate(lanes: list[int], data: bytes, offset: int, secret: int) -> None:
    for i in range(8):
        value = _word(data, offset + 8 * i)
        keyed = value ^ _word(_SECRET, secret + 8 * i)
        lanes[i ^ 1] = (lanes[i ^ 1] + value) & _MASK
        lanes[i] = (lanes[i] + (keyed & 0xFFFFFFFF) * (keyed >> 32)) & _MASK


def _scramble(lanes: list[int]) -> None:
    for i in range(8):
        lane = lanes[i] ^ (lanes[i] >> 47) ^ _word(_SECRET, 192 - _STRIPE + 8 * i)
        lanes[i] = lane * _PRIME32[0] & _MASK


def _merge(lanes: list[int], secret: int, start: int) -> int:
    total = start
    for i in range(4):
        keyed = (lanes[2 * i] ^ _word(_SECRET, secret + 16 * i), lanes[2 * i + 1] ^ _word(_SECRET, secret + 16 * i + 8))
        total += _fold(*keyed)
    return _avalanche(total & _MASK)


def _long(data: bytes) -> tuple[int, int]:
    """Low and high half for more than 240 bytes."""
    lanes = [_PRIME32[2], *_PRIME64[:4], _PRIME32[1], _PRIME64[4], _PRIME32[0]]
    length = len(data)
    block = _STRIPE * _STRIPES_PER_BLOCK
    blocks = (length - 1) // block
    for number in range(blocks):
        for i in range(_STRIPES_PER_BLOCK):
            _accumulate(lanes, data, number * block + i * _STRIPE, 8 * i)
        _scramble(lanes)
    for i in range((length - 1 - block * blocks) // _STRIPE):
        _accumulate(lanes, data, blocks * block + i * _STRIPE, 8 * i)
    _accumulate(lanes, data, length - _STRIPE, 192 - _STRIPE - 7)
    low = _merge(lanes, 11, length * _PRIME64[0] & _MASK)
    high = _merge(lanes, 192 - _STRIPE - 11, ~(length * _PRIME64[1]) & _MASK)
    return low, high


def xxh3_128(data: bytes) -> tuple[int, int]:
    """(low, high) 64-bit halves of the hash.

    Raises:
        ValueError: The text has 128 bytes or fewer, for which another rule holds that is not needed here.
    """
    if len(data) <= 128:
        raise ValueError(f"text has {len(data)} bytes; this hash is made for more than 128")
    return _middle(data) if len(data) <= 240 else _long(data)
