"""Append-only file of complete records: a record that a full disk left incomplete is removed."""

from __future__ import annotations

import fcntl
import os
from contextlib import suppress
from pathlib import Path


class GrowingFile:
    """File that buffers writes and appends the buffer completely or not at all.

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
        # The lock tells other processes that the file still grows. Some network file systems do not support it.
        with suppress(OSError):
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        self._size = 0
        self.pending = bytearray()

    def write(self, data: bytes) -> int:
        """Add to the buffer; never fails."""
        self.pending += data
        return len(data)

    def tell(self) -> int:
        """Offset of the next byte in the file."""
        return self._size + len(self.pending)

    def flush(self) -> None:
        """Do nothing: only `append` writes to the file."""

    def append(self) -> None:
        """Append the buffer to the file.

        Raises:
            OSError: the disk is full or gone. File and buffer are unchanged, so that `append` can be repeated.
        """
        if not self.pending:
            return
        written = 0
        try:
            with memoryview(self.pending) as view:
                while written < len(view):
                    written += os.write(self._descriptor, view[written:])
        except OSError:
            # Remove the incomplete record: a reader stops at it and would not see what follows.
            os.ftruncate(self._descriptor, self._size)
            os.lseek(self._descriptor, self._size, os.SEEK_SET)
            raise
        self._size += written
        self.pending.clear()

    def sync(self) -> None:
        """Flush to the disk.

        Raises:
            OSError: the disk is gone.
        """
        os.fsync(self._descriptor)

    def close(self) -> None:
        """Close the file; the buffer is lost. Safe to call twice."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1
