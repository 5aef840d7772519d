"""Reader of recordings: scans, frames, grids and calibration."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, cast

from transport.exceptions import RecordingError, check_choice, errors_as
from transport.messages.codec import decode, from_ros, read_stance, read_time
from transport.messages.stance_pause import StancePause, decode_stance_pause
from transport.messages.stance_stream import StanceStream, decode_stance_stream
from transport.messages.terrain_message import EXTENTS, TerrainMessage, decode_terrain
from transport.recording.limits import MAXIMUM_CHUNK, BoundedFile, Unpacker
from transport.recording.records import (
    FlashRecord,
    FrameRecord,
    FrameReference,
    ScanRecord,
    StripeRecord,
    read_frame,
)
from transport.recording.topics import CALIBRATION_NAME, TYPES, short_name

SCAN_PARTS = ("scan/start", "scan/stripe", "scan/dark", "scan/flash", "scan/end")
CAMERAS = ("camera/on", "camera/off", "camera/on/compressed", "camera/off/compressed")


class StoredMessage(NamedTuple):
    """Message in a file: offset of its chunk, topic, publish time [ns], log time [ns], and payload."""

    chunk: int
    topic: str
    stamp: int
    log_time: int
    payload: bytes


class Recording(AbstractContextManager["Recording"]):
    """Open MCAP recording; use it in a `with` block.

    Everything but calibration and scans is read on demand. Reading raises RecordingError if the file is damaged.

    Attributes:
        path: path of the file.
        scans: scans in the order of recording; see `ScanRecord.is_whole` for incomplete ones.
        calibration: content of the attached `calibration.json`; None if there is none.
    """

    def __init__(self, path: str | Path) -> None:
        """Open the file, and read its calibration and scans; see `open_recording`."""
        from mcap.reader import make_reader

        self.path = Path(path)
        with errors_as(RecordingError, f"cannot read {self.path}"):
            self._file = BoundedFile(self.path)
        try:
            self._reader = make_reader(cast(Any, self._file), validate_crcs=True)
            self._summary = self._reader.get_summary()
            if self._summary is None or not self._summary.statistics:
                raise RecordingError(f"{self.path} has no index; `guara convert OLD.mcap NEW.mcap` creates one")
            self.calibration = self._read_calibration()
            self._frames: dict[tuple[str, int], int] = {}
            self.scans = tuple(self._read_scans())
        except RecordingError:
            self._file.close()
            raise
        except Exception as error:  # truncated data cause errors of the container, the decompressor or Python
            self._file.close()
            raise RecordingError(
                f"{self.path} is not a complete recording ({type(error).__name__}: {error}); if it was truncated, "
                f"`guara convert OLD.mcap NEW.mcap` restores what is in it"
            ) from error

    def __exit__(self, *error: object) -> None:
        """Close the recording."""
        self.close()

    def frame(self, reference: FrameReference) -> FrameRecord:
        """Read one frame.

        Raises:
            RecordingError: the frame is not in the file.
            MessageError: the frame is damaged.
        """
        topic, stamp = reference.topic, reference.stamp
        if (topic, stamp) in self._frames:
            for found in self._messages([topic], self._frames[topic, stamp]):
                if found.stamp == stamp:
                    return read_frame(decode(found.payload, TYPES[short_name(topic)]), stamp)
        raise RecordingError(f"{self.path} contains no frame of {topic} at {stamp} ns")

    def terrains(self, extent: str = "footprint") -> Iterator[TerrainMessage]:
        """Iterate over the grids of one extent, in order.

        Raises:
            RecordingError: the extent is unknown.
            MessageError: a grid is damaged.
        """
        check_choice("extent", extent, EXTENTS, RecordingError)
        return map(decode_terrain, self._payloads("terrain" if extent == "footprint" else "map"))

    def stance_pauses(self) -> Iterator[StancePause]:
        """Iterate over the announcements of stance pauses, in order; MessageError if one is damaged."""
        return map(decode_stance_pause, self._payloads("stance"))

    def stance_stream(self, since: int = 0, until: int | None = None) -> Iterator[StanceStream]:
        """Iterate over the stance batches written between two log times [ns]; MessageError if one is damaged."""
        return map(decode_stance_stream, self._payloads("stance_stream", since, until))

    def messages(self, short: str) -> Iterator[Any]:
        """Iterate over the message objects of a topic in order; `short` is its short name, without the robot.

        Raises:
            RecordingError: the topic is unknown.
            MessageError: a message is damaged.
        """
        return (message for _, message in self.written(short))

    def written(self, short: str) -> Iterator[tuple[int, Any]]:
        """Iterate as `messages` does, but over pairs of log time [ns since the Unix epoch] and message object."""
        if short not in TYPES:
            raise RecordingError(f"topic {short!r} is unknown; topics are {', '.join(TYPES)}")
        for found in self._messages(self._topics(short)):
            yield found.log_time, decode(found.payload, TYPES[short])

    def close(self) -> None:
        """Close the file; may be called twice."""
        self._file.close()

    def _topics(self, *short_names: str) -> list[str]:
        channels = self._summary.channels.values() if self._summary else ()
        return [channel.topic for channel in channels if short_name(channel.topic) in short_names]

    def _payloads(self, short: str, since: int = 0, until: int | None = None) -> Iterator[bytes]:
        return (found.payload for found in self._messages(self._topics(short), since=since, until=until))

    def _messages(
        self, topics: list[str], chunk: int | None = None, *, since: int = 0, until: int | None = None
    ) -> Iterator[StoredMessage]:
        """Iterate over the messages of some topics, in the order in which they were written.

        Args:
            topics: full names of the topics.
            chunk: offset of the only chunk to read; None = all.
            since, until: first and last log time [ns]; None = no limit.
        """
        if not topics:
            return
        summary = cast(Any, self._summary)
        wanted = {number: channel.topic for number, channel in summary.channels.items() if channel.topic in topics}
        try:
            for at, message in self._stored(summary, set(wanted), chunk, since, until):
                is_timely = since <= message.log_time and (until is None or message.log_time <= until)
                if message.channel_id in wanted and is_timely:
                    # The stamp of a frame is its publish_time, which equals its log_time in recordings of earlier
                    # versions.
                    topic = wanted[message.channel_id]
                    yield StoredMessage(at, topic, message.publish_time, message.log_time, message.data)
        except GeneratorExit:
            raise
        except Exception as error:  # of the container, the decompressor or Python
            raise RecordingError(
                f"{self.path} is damaged ({type(error).__name__}: {error}); `guara convert OLD.mcap NEW.mcap` "
                f"restores the rest"
            ) from error

    def _stored(
        self, summary: Any, channels: set[int], chunk: int | None, since: int, until: int | None
    ) -> Iterator[tuple[int, Any]]:
        """Iterate, in order, over the messages of the chunks that may contain these channels and times.

        With `chunk`, only the chunk at this offset is read.

        Yields:
            Offset of the chunk in the file (0 if the file has no chunk index), and message.
        """
        from mcap.data_stream import ReadDataStream
        from mcap.records import Chunk, Message
        from mcap.stream_reader import StreamReader

        if not summary.chunk_indexes:
            self._file.seek(0)
            for record in StreamReader(cast(Any, self._file), record_size_limit=MAXIMUM_CHUNK).records:
                if isinstance(record, Message):
                    yield 0, record
            return
        unpacker = Unpacker(self._file.size)
        for index in sorted(summary.chunk_indexes, key=lambda index: index.chunk_start_offset):
            at = index.chunk_start_offset
            is_there = chunk in (None, at) and since <= index.message_end_time
            is_there &= until is None or index.message_start_time <= until
            if is_there and (not index.message_index_offsets or channels & index.message_index_offsets.keys()):
                # Skip opcode and length of the record.
                self._file.seek(at + 9)
                for record in unpacker.records(Chunk.read(ReadDataStream(cast(Any, self._file)))):
                    if isinstance(record, Message):
                        yield at, record

    def _read_calibration(self) -> bytes | None:
        found = [item.data for item in self._reader.iter_attachments() if item.name == CALIBRATION_NAME]
        return found[-1] if found else None

    def _read_scans(self) -> Iterator[ScanRecord]:
        start: Any = None
        stripes: list[StripeRecord] = []
        for found in self._messages(self._topics(*SCAN_PARTS, *CAMERAS)):
            short = short_name(found.topic)
            if short in CAMERAS:
                self._frames[found.topic, found.stamp] = found.chunk
                continue
            body = decode(found.payload, TYPES[short])
            if short == "scan/start":
                if start is not None:
                    yield _make_scan(start, stripes, None)
                start, stripes = body, []
            elif start is not None and short == "scan/stripe":
                stripes.append(_make_stripe(body))
            elif short in ("scan/dark", "scan/flash"):
                found_of = _dark_of if short == "scan/dark" else _flash_of
                stripes = [
                    replace(stripe, **found_of(body)) if stripe.index == body.index else stripe for stripe in stripes
                ]
            elif start is not None:
                yield _make_scan(start, stripes, body)
                start = None
        if start is not None:
            yield _make_scan(start, stripes, None)


def _reference(topic: str, stamp: Any) -> FrameReference | None:
    return FrameReference(topic, read_time(stamp)) if topic else None


def _dark_of(body: Any) -> dict[str, Any]:
    return {"dark": _reference(body.off_topic, body.off_stamp), "is_dark_due": True}


def _flash_of(body: Any) -> dict[str, Any]:
    stamps = read_time(body.header.stamp), read_time(body.on_stamp), read_time(body.off_stamp)
    return {"flash": FlashRecord(*stamps)}


def _make_stripe(body: Any) -> StripeRecord:
    on, off = _reference(body.on_topic, body.on_stamp), _reference(body.off_topic, body.off_stamp)
    return from_ros(StripeRecord, body, on=on, off=off)


def _make_scan(start: Any, stripes: list[StripeRecord], end: Any) -> ScanRecord:
    return from_ros(
        ScanRecord,
        start,
        stance_end=read_stance(end.stance_end) if end is not None and end.has_stance_end else None,
        stripes=tuple(stripes),
        is_whole=end is not None and end.stripes == len(stripes),
    )


def open_recording(path: str | Path) -> Recording:
    """Open an MCAP recording.

    Raises:
        RecordingError: the file cannot be read, is not an MCAP file, or is truncated or damaged.
    """
    return Recording(path)
