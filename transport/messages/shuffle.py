"""Compression of arrays for slow links: byte shuffle, then zstd.

The byte shuffle, as in HDF5 and Blosc, stores the first bytes of all elements, then all second bytes, and so on. Bytes
after the last complete element are appended unchanged.
"""

from __future__ import annotations

import importlib
import sys
from typing import Any

import numpy as np

from transport.arrays import Bytes
from transport.exceptions import MessageError
from transport.messages.codec import MAXIMUM_PAYLOAD

# First bytes of every zstd frame; no CDR payload begins with them.
FRAME_MAGIC = b"\x28\xb5\x2f\xfd"
# A higher level saves a few per cent and takes several times as long.
ZSTD_LEVEL = 3


def compress(data: bytes | bytearray | memoryview, itemsize: int = 4) -> bytes:
    """Shuffle data and compress them to one zstd frame that contains their size and a checksum.

    Args:
        data: bytes of an array.
        itemsize: size of an element [bytes].
    """
    zstd = _zstd()
    of = zstd.CompressionParameter
    options = {of.compression_level: ZSTD_LEVEL, of.content_size_flag: 1, of.checksum_flag: 1}
    return bytes(zstd.compress(_transposed(data, itemsize, encode=True).tobytes(), options=options))


def decompress(data: bytes | bytearray | memoryview, itemsize: int = 4, *, maximum: int = MAXIMUM_PAYLOAD) -> bytes:
    """Decompress and unshuffle data; inverse of `compress`.

    Args:
        data: a single complete zstd frame.
        itemsize: size of an element [bytes], as in `compress`.
        maximum: largest allowed result [bytes]; a frame that declares more is rejected before decompression.

    Raises:
        MessageError: the frame is damaged or truncated, declares no length or one above `maximum`, or is followed by
            other data.
    """
    zstd = _zstd()
    try:
        size = zstd.get_frame_info(data).decompressed_size
        if size is None:
            raise MessageError("zstd frame refused: it does not declare its length")
        if size > maximum:
            raise MessageError(f"zstd frame that decompresses to {size} bytes refused; allowed: up to {maximum} bytes")
        decompressor = zstd.ZstdDecompressor()
        plain = decompressor.decompress(data, max_length=size + 1)
    except zstd.ZstdError as error:
        raise MessageError(f"{len(data)} bytes are not a complete zstd frame: {error}") from error
    if not decompressor.eof or decompressor.unused_data or len(plain) != size:
        raise MessageError(f"{len(data)} bytes are not a complete zstd frame: it is truncated, or other data follow")
    return _transposed(plain, itemsize, encode=False).tobytes()


def _zstd() -> Any:
    """Import Python's own zstd module or, before Python 3.14, its backport, which rosbags also needs."""
    return importlib.import_module("compression.zstd" if sys.version_info >= (3, 14) else "backports.zstd")


def _transposed(data: bytes | bytearray | memoryview, itemsize: int, *, encode: bool) -> Bytes:
    """Shuffle (`encode`) or unshuffle the bytes of all complete elements."""
    flat = np.frombuffer(data, np.uint8)
    count = len(flat) // itemsize
    whole = count * itemsize
    result = np.empty_like(flat)
    # Strided slices are used because numpy takes five times as long to copy a transposed array.
    for byte in range(itemsize):
        together, apart = slice(byte * count, (byte + 1) * count), slice(byte, whole, itemsize)
        here, there = (together, apart) if encode else (apart, together)
        result[here] = flat[there]
    result[whole:] = flat[whole:]
    return result
