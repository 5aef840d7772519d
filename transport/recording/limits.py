"""Limits of the memory needed to read a recording: 128 kB of a hostile file can decompress to gigabytes."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from io import BufferedReader, BytesIO, FileIO
from pathlib import Path
from typing import Any

from transport.exceptions import RecordingError

# Largest decompressed chunk [bytes]. A chunk is usually 1 MiB, or contains a single frame (72 MB for 12 Mpx with three
# channels of 16 bits).
MAXIMUM_CHUNK = 96 * 1024 * 1024
# Largest decompressed size of all chunks [bytes]: MAXIMUM_UNPACKED plus MAXIMUM_RATIO times the size of the file.
MAXIMUM_UNPACKED, MAXIMUM_RATIO = 256 * 1024 * 1024, 100
# Largest number of records in all chunks: MAXIMUM_RECORDS plus the size of the file divided by BYTES_PER_RECORD.
MAXIMUM_RECORDS, BYTES_PER_RECORD = 100_000, 64


class BoundedFile(BufferedReader):
    """File whose reads are limited to the bytes that remain, whatever lengths its records claim."""

    def __init__(self, path: Path) -> None:
        """Open the file for reading; OSError if this fails."""
        super().__init__(FileIO(path))
        self.size = path.stat().st_size

    def read(self, count: int | None = -1) -> bytes:
        """Read at most `count` bytes; None or a negative count reads all bytes that remain."""
        left = max(0, self.size - self.tell())
        return super().read(left if count is None or count < 0 else min(count, left))


class Unpacker:
    """Decompressor for the chunks of one file, with limits that depend on the size of the file."""

    def __init__(self, size: int) -> None:
        """Set the limits for a file of `size` bytes."""
        self._bytes = MAXIMUM_UNPACKED + MAXIMUM_RATIO * size
        self._records = MAXIMUM_RECORDS + size // BYTES_PER_RECORD

    def records(self, chunk: Any) -> Iterator[Any]:
        """Iterate over the schemas, channels and messages of a chunk.

        Raises:
            RecordingError: a limit is exceeded, or a length or checksum in the chunk is wrong.
            Exception: the data are damaged; raised by the decompressor or by MCAP.
        """
        from mcap.data_stream import ReadDataStream
        from mcap.opcode import Opcode
        from mcap.records import Channel, Message, Schema

        data = self._unpacked(chunk)
        stream: Any = ReadDataStream(BytesIO(data))
        while stream.count < len(data):
            self._records -= 1
            if self._records < 0:
                raise RecordingError("the file contains more records than a recording of its size can have")
            opcode, length = stream.read1(), stream.read8()
            if length > len(data) - stream.count:
                raise RecordingError(
                    f"a record claims {length} bytes; its chunk has only {len(data) - stream.count} left"
                )
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
            raise RecordingError(
                f"a chunk decompresses to {size} bytes; allowed: {MAXIMUM_CHUNK} bytes, and for all chunks together "
                f"{MAXIMUM_UNPACKED} bytes plus {MAXIMUM_RATIO} times the size of the file"
            )
        if chunk.compression == "zstd":
            import zstandard

            # The decompressor allocates the size stated in the frame, not `max_output_size`.
            stated = zstandard.get_frame_parameters(chunk.data).content_size
            if stated not in (size, zstandard.CONTENTSIZE_UNKNOWN):
                raise RecordingError(f"a chunk declares {size} decompressed bytes, its zstd frame {stated}")
            data = zstandard.ZstdDecompressor().decompress(chunk.data, max_output_size=size)
        elif chunk.compression == "lz4":
            import lz4.frame

            data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=size)
        else:
            data = chunk.data
        if len(data) != size:
            raise RecordingError(f"a chunk declares {size} decompressed bytes, but contains {len(data)}")
        if chunk.uncompressed_crc not in (0, zlib.crc32(data)):
            raise RecordingError("the checksum of a chunk is wrong")
        return bytes(data)
