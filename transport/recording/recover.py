"""Recovery of truncated or damaged recordings: data that can still be read are copied to a new, indexed file."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from transport.exceptions import RecordingError, errors_as
from transport.recording.limits import MAXIMUM_CHUNK, BoundedFile, Unpacker
from transport.recording.topic_file import CHUNK_SIZE

# Largest record [bytes]; a larger record counts as damaged.
RECORD_LIMIT = MAXIMUM_CHUNK + 1024 * 1024


@dataclass(frozen=True, slots=True)
class Recovery:
    """Result of the recovery of a recording.

    Attributes:
        messages: number of recovered messages.
        attachments: number of recovered attachments.
        damaged_chunks: number of complete chunks that were left out because their content is damaged or exceeds the
            limits of `Unpacker`.
        bytes_lost: number of bytes from the first damaged record to the end of the file; 0 if the end of the data was
            reached.
        was_whole: True if all data were present and undamaged; the index at the end of the file is not checked.
    """

    messages: int
    attachments: int
    damaged_chunks: int
    bytes_lost: int
    was_whole: bool


def recover_recording(source: str | Path, destination: str | Path) -> Recovery:
    """Copy messages and attachments of `source`, up to the first damaged record, to the new file `destination`.

    Damaged chunks are left out; copying continues after them.

    Raises:
        RecordingError: `source` cannot be read or is not an MCAP file, or `destination` exists or cannot be written.
    """
    from mcap.writer import CompressionType, Writer

    old, new = Path(source), Path(destination)
    if new.exists():
        raise RecordingError(f"{new} exists; give another name, or remove it first")
    partial = new.with_name(f".{new.name}.part")
    # Counts of messages, attachments and damaged chunks; position in the file; "ended" is 1 once the end was reached.
    counts = Counter[str]()
    try:
        with errors_as(RecordingError, f"cannot recover {old} into {new}"):
            size = old.stat().st_size
            with closing(BoundedFile(old)) as stream, partial.open("wb") as output:
                writer = Writer(output, chunk_size=CHUNK_SIZE, compression=CompressionType.ZSTD)
                writer.start(profile="ros2", library="guara-perception")
                _copy(_records(stream, counts, old), writer, counts)
                writer.finish()
                output.flush()
                os.fsync(output.fileno())
            partial.replace(new)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise
    has_ended, damaged = bool(counts["ended"]), counts["damaged"]
    lost = 0 if has_ended else size - counts["position"]
    return Recovery(counts["messages"], counts["attachments"], damaged, lost, has_ended and not damaged)


def _records(stream: Any, counts: Counter[str], path: Path) -> Iterator[Any]:
    """Iterate over the records, including those in chunks, until the end of the data or a damaged record.

    Damaged chunks are skipped and counted.
    """
    from mcap.records import Chunk, DataEnd
    from mcap.stream_reader import StreamReader

    unpacker = Unpacker(stream.size)
    reader = StreamReader(stream, emit_chunks=True, record_size_limit=RECORD_LIMIT)
    records = iter(reader.records)
    while True:
        try:
            record = next(records)
        except StopIteration:
            return
        except Exception as error:  # truncated data may cause EndOfFile, struct.error or any other error
            if counts["position"] == 0:
                raise RecordingError(f"{path} is not an MCAP file ({error})") from error
            return
        counts["position"] = stream.tell()
        if isinstance(record, DataEnd):
            counts["ended"] = 1
            return
        if not isinstance(record, Chunk):
            yield record
            continue
        # A chunk is copied completely or not at all, because a message may be meaningless without those before it.
        try:
            inner = list(unpacker.records(record))
        except Exception:  # errors of the decompressor and of MCAP
            counts["damaged"] += 1
            continue
        yield from inner


def _copy(records: Iterator[Any], writer: Any, counts: Counter[str]) -> None:
    from mcap.records import Attachment, Channel, Message, Schema

    schemas: dict[int, int] = {}
    channels: dict[int, int] = {}
    for record in records:
        if isinstance(record, Schema):
            if record.id not in schemas:
                schemas[record.id] = writer.register_schema(record.name, record.encoding, record.data)
        elif isinstance(record, Channel):
            if record.id not in channels and record.schema_id in schemas:
                channels[record.id] = writer.register_channel(
                    record.topic, record.message_encoding, schemas[record.schema_id], record.metadata
                )
        elif isinstance(record, Message):
            if record.channel_id in channels:
                channel = channels[record.channel_id]
                writer.add_message(channel, record.log_time, record.data, record.publish_time, record.sequence)
                counts["messages"] += 1
        elif isinstance(record, Attachment):
            writer.add_attachment(record.create_time, record.log_time, record.name, record.media_type, record.data)
            counts["attachments"] += 1
