"""Limits on the memory that reading a recording takes: 128 kB of a hostile file can unpack to gigabytes."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from io import BufferedReader, BytesIO, FileIO
from pathlib import Path
from typing import Any

from transport.exceptions import RecordingError

# [byte] Largest chunk once unpacked; one holds 1 MiB, or a single frame (12 Mpx of three channels at 16 bit: 72 MB).
MAXIMUM_CHUNK = 96 * 1024 * 1024
# [byte] A file may unpack to this, plus its own length times the ratio.
MAXIMUM_UNPACKED, MAXIMUM_RATIO = 256 * 1024 * 1024, 100
# A file may hold this number of records, plus its own length divided by the bytes for each.
MAXIMUM_RECORDS, BYTES_PER_RECORD = 100_000, 64


class BoundedFile(BufferedReader):
    """A file of which no more bytes are read than it has left, whatever a length in it says."""

    def __init__(self, path: Path) -> None:
        """Open it for reading; OSError when that fails."""
        super().__init__(FileIO(path))
        self.size = path.stat().st_size

    def read(self, count: int | None = -1) -> bytes:
        """At most `count` bytes."""
        left = max(0, self.size - self.tell())
        return super().read(left if count is None or count < 0 else min(count, left))


class Unpacker:
    """Unpacks the chunks of one file, and refuses more than a recording of its length can hold."""

    def __init__(self, size: int) -> None:
        """For a file of `size` bytes."""
        self._bytes = MAXIMUM_UNPACKED + MAXIMUM_RATIO * size
        self._records = MAXIMUM_RECORDS + size // BYTES_PER_RECORD

    def records(self, chunk: Any) -> Iterator[Any]:
        """The schemas, channels and messages of a chunk, one by one.

        Raises:
            RecordingError: it unpacks to too much.
            Exception: whatever damaged bytes provoke in the decompressor and in MCAP.
        """
        from mcap.data_stream import ReadDataStream
        from mcap.opcode import Opcode
        from mcap.records import Channel, Message, Schema

        data = self._unpacked(chunk)
        stream: Any = ReadDataStream(BytesIO(data))
        while stream.count < len(data):
            self._records -= 1
            if self._records < 0:
                raise RecordingError("the file holds more records than a recording of its length can")
            opcode, length = stream.read1(), stream.read8()
            if length > len(data) - stream.count:
                raise RecordingError(f"a record of {length} bytes in a chunk with {len(data) - stream.count} left")
            if opcode == Opcode.MESSAGE:
                yield Message.read(stream, length)
            elif opcode == Opcode.CHANNEL:
                yield Channel.read(stream)
            elif opcode == Opcode.SCHEMA:
                yield Schema.read(stream)
            else:
                stream.read(length)

    def _unpacked(self, chunk: Any) -> bytes:
        size = int(chunk.uncompressed_size)
        self._bytes -= size
        if size > MAXIMUM_CHUNK or self._bytes < 0:
            raise RecordingError(f"a chunk unpacks to {size} bytes; allowed: {MAXIMUM_CHUNK}, and less where many do")
        if chunk.compression == "zstd":
            import zstandard

            # The size in the frame itself counts for the decompressor, not the one that it is given.
            stated = zstandard.get_frame_parameters(chunk.data).content_size
            if stated not in (size, zstandard.CONTENTSIZE_UNKNOWN):
                raise RecordingError(f"a chunk of {size} bytes says that it unpacks to {stated}")
            data = zstandard.ZstdDecompressor().decompress(chunk.data, max_output_size=size)
        elif chunk.compression == "lz4":
            import lz4.frame

            data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=size)
        else:
            data = chunk.data
        if len(data) != size:
            raise RecordingError(f"a chunk of {size} bytes unpacks to {len(data)}")
        if chunk.uncompressed_crc not in (0, zlib.crc32(data)):
            raise RecordingError("the checksum of a chunk is wrong")
        return bytes(data)
