"""Append-only file of whole records: a record that a full disk left incomplete is truncated."""

from __future__ import annotations

import fcntl
import os
from contextlib import suppress
from pathlib import Path


class GrowingFile:
    """Buffers what is written and appends it all or nothing; what could not be appended stays in the buffer.

    Attributes:
        pending: bytes that were not appended yet.
    """

    def __init__(self, path: Path, *, empties: bool = False) -> None:
        """Create the file.

        Args:
            path: name of the file.
            empties: truncate an existing file.

        Raises:
            OSError: it exists or cannot be created.
        """
        how = os.O_TRUNC if empties else os.O_EXCL
        self._descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | how | os.O_CLOEXEC, 0o666)
        # Tells others that the file still grows; the lock goes with the process. Some network disks have none.
        with suppress(OSError):
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        self._size = 0
        self.pending = bytearray()

    def write(self, data: bytes) -> int:
        """Collect; never fails."""
        self.pending += data
        return len(data)

    def tell(self) -> int:
        """Offset at which the next byte will stand."""
        return self._size + len(self.pending)

    def flush(self) -> None:
        """Do nothing: only `append` writes, and reports errors."""

    def append(self) -> None:
        """Append all that was collected.

        Raises:
            OSError: the disk is full or gone. The file then ends where it ended before, and everything is still there
                for the next attempt.
        """
        if not self.pending:
            return
        written = 0
        try:
            with memoryview(self.pending) as view:
                while written < len(view):
                    written += os.write(self._descriptor, view[written:])
        except OSError:
            # The incomplete record must go: a reader stops at it, and would never see what follows.
            os.ftruncate(self._descriptor, self._size)
            os.lseek(self._descriptor, self._size, os.SEEK_SET)
            raise
        self._size += written
        self.pending.clear()

    def sync(self) -> None:
        """Wait for the disk.

        Raises:
            OSError: the disk is gone.
        """
        os.fsync(self._descriptor)

    def close(self) -> None:
        """Close the file; what was not appended is lost. Safe to call twice."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1
