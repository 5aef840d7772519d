"""Compression of arrays for slow links: byte shuffle, then zstd.

The shuffle is that of HDF5 and Blosc: the first bytes of all elements, then all second bytes, and so on; bytes after
the last whole element are appended unchanged.
"""

from __future__ import annotations

import numpy as np

from transport.arrays import Bytes
from transport.exceptions import MessageError
from transport.messages.codec import MAXIMUM_PAYLOAD

# First bytes of every zstd frame, and of no CDR payload.
FRAME_MAGIC = b"\x28\xb5\x2f\xfd"
# A higher level gains a few per cent and takes several times as long.
ZSTD_LEVEL = 3


def compress(data: bytes | bytearray | memoryview, itemsize: int = 4) -> bytes:
    """Shuffle and compress into one zstd frame with content size and checksum.

    Args:
        data: array of elements.
        itemsize: size of an element [byte].
    """
    import zstandard

    parameters = zstandard.ZstdCompressionParameters.from_level(
        ZSTD_LEVEL, source_size=len(data), write_content_size=True, write_checksum=True
    )
    return zstandard.ZstdCompressor(compression_params=parameters).compress(
        _transposed(data, itemsize, encode=True).tobytes()
    )


def decompress(data: bytes | bytearray | memoryview, itemsize: int = 4, *, maximum: int = MAXIMUM_PAYLOAD) -> bytes:
    """Decompress and unshuffle; inverse of `compress`.

    Args:
        data: one complete zstd frame.
        itemsize: size of an element, the same as in `compress` [byte].
        maximum: largest result [byte]; a frame that declares more is rejected before decompression.

    Raises:
        MessageError: the frame is damaged, truncated, too large, does not state its length, or has trailing bytes.
    """
    import zstandard

    try:
        frame = zstandard.get_frame_parameters(data)
        if frame.content_size == zstandard.CONTENTSIZE_UNKNOWN:
            raise MessageError("a zstd frame that does not state its length refused")
        if frame.content_size > maximum:
            raise MessageError(f"a compressed message of {frame.content_size} bytes refused; allowed: {maximum} bytes")
        plain = zstandard.ZstdDecompressor().decompress(data, allow_extra_data=False)
    except zstandard.ZstdError as error:
        raise MessageError(f"{len(data)} bytes are no whole zstd frame: {error}") from error
    return _transposed(plain, itemsize, encode=False).tobytes()


def _transposed(data: bytes | bytearray | memoryview, itemsize: int, *, encode: bool) -> Bytes:
    """Shuffle (`encode`) or unshuffle the bytes of the whole elements."""
    flat = np.frombuffer(data, np.uint8)
    count = len(flat) // itemsize
    whole = count * itemsize
    result = np.empty_like(flat)
    # Strided slices: numpy takes five times as long to copy a transposed array.
    for byte in range(itemsize):
        together, apart = slice(byte * count, (byte + 1) * count), slice(byte, whole, itemsize)
        here, there = (together, apart) if encode else (apart, together)
        result[here] = flat[there]
    result[whole:] = flat[whole:]
    return result
