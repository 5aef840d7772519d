"""Append-only file of complete records; a record that a full disk left incomplete is removed."""

from __future__ import annotations

import fcntl
import os
from contextlib import suppress
from pathlib import Path


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
