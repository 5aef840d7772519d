"""MCAP file to which payloads are added by topic; flushed data survive the end of the process."""

from __future__ import annotations

import fcntl
import os
import threading
import time
from contextlib import AbstractContextManager, closing, suppress
from pathlib import Path
from typing import Any, cast

from transport.exceptions import RecordingError, errors_as
from transport.keys import check_name
from transport.messages.typestore import message_definition
from transport.recording.topics import TYPES, full_name, quality_of_service

# Size of a chunk [bytes]. Larger chunks do not compress better, and a process that is killed loses its last chunk.
CHUNK_SIZE = 1024 * 1024
# Largest buffer for data that do not fit on a full disk [bytes]; about one scan.
MAXIMUM_PENDING = 64 * 1024 * 1024


class GrowingFile:
    """File that buffers writes, and appends the buffer completely or not at all.

    Attributes:
        pending: buffered bytes that have not been appended yet.
    """

    def __init__(self, path: Path, *, empties: bool = False) -> None:
        """Create the file.

        Args:
            path: path of the file.
            empties: True = truncate an existing file.

        Raises:
            OSError: the file exists and `empties` is False, or it cannot be created.
        """
        how = os.O_TRUNC if empties else os.O_EXCL
        self._descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | how | os.O_CLOEXEC, 0o666)
        # The lock tells other processes that the file is still being written. Some network file systems do not support
        # locks.
        with suppress(OSError):
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        self._size = 0
        self.pending = bytearray()

    def write(self, data: bytes) -> int:
        """Add data to the buffer; never fails."""
        self.pending += data
        return len(data)

    def tell(self) -> int:
        """Return the offset of the next byte in the file."""
        return self._size + len(self.pending)

    def flush(self) -> None:
        """Do nothing, because only `append` writes to the file."""

    def append(self) -> None:
        """Append the buffer to the file.

        Raises:
            OSError: the write failed. On a full disk, file and buffer are unchanged, and `append` can be repeated.
        """
        if not self.pending:
            return
        written = 0
        try:
            with memoryview(self.pending) as view:
                while written < len(view):
                    written += os.write(self._descriptor, view[written:])
        except OSError:
            # Remove the incomplete record, because a reader would stop there and miss what follows.
            os.ftruncate(self._descriptor, self._size)
            os.lseek(self._descriptor, self._size, os.SEEK_SET)
            raise
        self._size += written
        self.pending.clear()

    def sync(self) -> None:
        """Flush the file to the disk.

        Raises:
            OSError: the data cannot be written to the disk.
        """
        os.fsync(self._descriptor)

    def close(self) -> None:
        """Close the file without appending the buffer; may be called twice."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1


class TopicFile(AbstractContextManager["TopicFile"]):
    """MCAP file being written; thread-safe. A topic is registered with its first payload."""

    def __init__(self, path: str | Path, robot: str, *, atomic: bool = False, sync: bool = False) -> None:
        """Create the file.

        Args:
            path: path of the new file, usually `*.mcap`.
            robot: instance name, which is part of the topic names.
            atomic: True = write under a temporary name, and rename the file when it is complete.
            sync: True = `flush` also writes to the disk, so that flushed data survive a loss of power.

        Raises:
            RecordingError: the file exists or cannot be created.
            KeyNameError: the robot's name cannot be part of a topic name.
        """
        from mcap.writer import CompressionType, Writer

        self.path = path = Path(path)
        self._robot, self._atomic, self._sync = check_name(robot), atomic, sync
        self._partial = path.with_name(f".{path.name}.part") if atomic else path
        self._lock = threading.RLock()
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._log_time = 0
        self._closed = False
        if path.exists():
            raise RecordingError(f"{path} exists; give another name, or remove it first")
        with errors_as(RecordingError, f"cannot write {path}"):
            self._file = GrowingFile(self._partial, empties=atomic)
        self._writer = Writer(cast(Any, self._file), chunk_size=CHUNK_SIZE, compression=CompressionType.ZSTD)
        self._writer.start(profile="ros2", library="guara-perception")

    @property
    def size(self) -> int:
        """Size of the file [bytes]: includes data buffered for a full disk, but not the unfinished chunk."""
        with self._lock:
            return self._file.tell()

    def attach(self, name: str, kind: str, content: bytes) -> None:
        """Attach the content of a file; the attachment is buffered if the disk is full.

        Raises:
            RecordingError: the file is closed.
        """
        with self._lock:
            self._check_open()
            self._writer.add_attachment(0, 0, name, kind, content)
            with suppress(OSError):
                self._file.append()

    def add(self, short: str, payload: bytes | bytearray, stamp: int | None = None) -> None:
        """Add a CDR payload to a topic of `TYPES`; `stamp` is its publish time [ns], None = the time of writing.

        Raises:
            RecordingError: the file is closed, or writing fails and the buffer exceeds `MAXIMUM_PENDING`.
        """
        with self._lock:
            self._check_open()
            if len(self._file.pending) > MAXIMUM_PENDING:
                self.flush()
            # The clock may be set back during a recording, but log_time must not decrease in the order of writing.
            self._log_time = max(self._log_time, time.time_ns())
            self._writer.add_message(
                self._channel(short), self._log_time, bytes(payload), self._log_time if stamp is None else stamp
            )
            # The data are not acknowledged yet; if the error persists, the next flush raises it.
            with suppress(OSError):
                self._file.append()

    def flush(self) -> None:
        """Write all added data to the file, and with `sync` also to the disk.

        Raises:
            RecordingError: the file is closed, or the write failed, for example because the disk is full.
        """
        with self._lock, errors_as(RecordingError, f"cannot write {self.path}"):
            self._check_open()
            self._writer.flush()
            self._file.append()
            if self._sync:
                self._file.sync()

    def close(self) -> None:
        """Write the index and close the file; with `atomic`, also rename it. May be called twice.

        Raises:
            RecordingError: the write failed, for example because the disk is full.
        """
        with self._lock, errors_as(RecordingError, f"cannot finish {self.path}"), closing(self._file):
            if not self._closed:
                self._closed = True
                self._writer.finish()
                self._file.append()
                self._file.sync()
                if self._atomic:
                    self._partial.replace(self.path)

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        """Finish the file; with `atomic`, delete it instead if the block was left by an exception."""
        if error is None or not self._atomic:
            self.close()
        elif not self._closed:
            self._closed = True
            self._file.close()
            self._partial.unlink(missing_ok=True)

    def _check_open(self) -> None:
        if self._closed:
            raise RecordingError(f"the recording {self.path} is closed")

    def _channel(self, short: str) -> int:
        if short not in self._channels:
            name = TYPES[short]
            if name not in self._schemas:
                text = message_definition(name).encode()
                self._schemas[name] = self._writer.register_schema(name, "ros2msg", text)
            topic, metadata = full_name(short, self._robot), {"offered_qos_profiles": quality_of_service(short)}
            self._channels[short] = self._writer.register_channel(topic, "cdr", self._schemas[name], metadata)
        return self._channels[short]
