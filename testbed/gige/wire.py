"""The messages between a `FakeGigeCamera` and its process."""

from __future__ import annotations

import struct
from typing import IO

# Kind, time of the exposure on the camera's clock [ns], number of bytes of the picture that follows.
REQUEST = struct.Struct("<cQI")
EXPOSE, ASK = b"X", b"?"
# Whether the request was carried out; width, height, pixel format, exposure [us], gain, source of the output line.
STATE = struct.Struct("<7I")


def read_exactly(stream: IO[bytes], count: int) -> bytes | None:
    """Read a number of bytes; None when the stream ends before."""
    data = stream.read(count)
    return data if len(data) == count else None
