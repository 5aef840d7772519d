"""Messages between a `FakeGigeCamera` and its process."""

from __future__ import annotations

import struct
from typing import IO

# Request: kind, time of the exposure on the camera's clock [ns], number of bytes of the image that follows.
REQUEST = struct.Struct("<cQI")
EXPOSE, ASK = b"X", b"?"
# Answer: 1 if the request was executed, width, height, pixel format, exposure [us], gain, source of the output line.
STATE = struct.Struct("<7I")


def read_exactly(stream: IO[bytes], count: int) -> bytes | None:
    """Read a number of bytes; return None if the stream ends before."""
    data = stream.read(count)
    return data if len(data) == count else None
