"""Names and disk space of the successive files of a recording."""

from __future__ import annotations

import fcntl
import os
import re
from contextlib import suppress
from fractions import Fraction
from pathlib import Path

from guara_perception.exceptions import InvalidInput
from transport.exceptions import RecordingError, errors_as

SUFFIX = ".mcap"
# [byte] Size at which the next file of a folder is started. For frames of 640 x 512 px and a pause every 4 s, this is
# 12 minutes of JPEG frames or 100 s of lossless frames.
FILE_SIZE = 1_000_000_000
# With a limit, the next file is started at a fifth of the limit at the latest, so that finished files remain when the
# oldest is removed.
FILES_IN_LIMIT = 5
# [byte] Smallest limit. A fifth of it has room for the lossless frames of a pause (39 MB), so this limit can be kept.
LEAST_LIMIT = 200_000_000
UNITS = {"MB": 10**6, "GB": 10**9, "TB": 10**12}
SIZE = re.compile(r"(\d{1,9}(?:\.\d{1,9})?) ?([MGT]B)", re.IGNORECASE)
# First and last bytes of an MCAP file.
MAGIC = b"\x89MCAP0\r\n"


class RecordingFiles:
    """Successive files of a recording: `w.mcap`, `w-2.mcap` ..., or `<robot>-000001.mcap` ... in a folder.

    Existing files are never written to. With a limit, only files with these names are removed, and never a file that a
    process is still writing.

    Attributes:
        file_size: size at which the next file is started [byte]; None = a single file of any size.
    """

    def __init__(self, path: Path, robot: str, limit: int | None = None) -> None:
        """Set the pattern of the names, and create the folder if needed.

        Args:
            path: file name that ends with .mcap, or a folder.
            robot: instance name of the robot.
            limit: largest total size of the files of a folder [byte], from `read_limit`; None = no limit.

        Raises:
            RecordingError: the folder cannot be created.
        """
        is_folder = _is_folder(path)
        self._folder = path if is_folder else path.parent
        if is_folder:
            try:
                path.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                why = "a file has this name" if path.is_file() else error.strerror
                raise RecordingError(f"cannot create the folder {path} for recordings: {why}") from error
        self._limit = limit
        self._first = None if is_folder else path
        number = r"-(\d{6,})" if is_folder else r"(?:-(\d+))?"
        self._stem = robot if is_folder else path.stem
        self._pattern = re.compile(re.escape(self._stem) + number + re.escape(SUFFIX))
        self.file_size = (
            None if not is_folder else FILE_SIZE if limit is None else min(FILE_SIZE, limit // FILES_IN_LIMIT)
        )

    def next(self) -> Path:
        """Path of the next file: the file name, if one was given and is unused, otherwise a name with the next number.

        Raises:
            RecordingError: the folder does not exist or cannot be read.
        """
        with errors_as(RecordingError, f"cannot record into the folder {self._folder}"):
            numbers = [number for number, _ in self._found()]
        if self._first is None:
            return self._folder / f"{self._stem}-{max(numbers, default=0) + 1:06d}{SUFFIX}"
        if not os.path.lexists(self._first):
            return self._first
        return self._folder / f"{self._stem}-{max(numbers) + 1}{SUFFIX}"

    def make_room(self) -> None:
        """Remove the oldest files, except those being written, until the limit has room for two more files.

        The second is a reserve, since a file exceeds its size by up to one pause.

        Raises:
            RecordingError: the folder cannot be read, or a file cannot be removed.
        """
        if self._limit is None or self.file_size is None:
            return
        try:
            files = [
                (path, path.stat().st_size) for _, path in self._found() if path.is_file() and not path.is_symlink()
            ]
            excess = sum(size for _, size in files) - (self._limit - 2 * self.file_size)
            for path, size in files:
                if excess > 0 and _remove_finished(path):
                    excess -= size
        except OSError as error:
            raise RecordingError(f"cannot keep --record-limit: {error.filename}: {error.strerror}") from error

    def cut(self) -> list[Path]:
        """Incomplete files, oldest first: the file being written, and files whose process was killed."""
        with suppress(OSError):
            return [path for _, path in self._found() if path.is_file() and not _has_end(path)]
        return []

    def _found(self) -> list[tuple[int, Path]]:
        matches = ((self._pattern.fullmatch(path.name), path) for path in self._folder.iterdir())
        return sorted((int(match[1] or 1), path) for match, path in matches if match)


def _remove_finished(path: Path) -> bool:
    """Remove a file; return False if it is locked, which means that a process is still writing it."""
    with path.open("rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        path.unlink()
        return True


def _has_end(path: Path) -> bool:
    with path.open("rb") as file:
        file.seek(max(0, file.seek(0, os.SEEK_END) - len(MAGIC)))
        return file.read() == MAGIC


def read_limit(text: str, path: Path | None) -> int:
    """Convert a size such as "50GB" to bytes.

    Args:
        text: size given by the user.
        path: file or folder to record to, or None.

    Raises:
        InvalidInput: the text is not a size, the size is too small, or `path` is None or a file.
    """
    match = SIZE.fullmatch(text.strip())
    limit = int(Fraction(match[1]) * UNITS[match[2].upper()]) if match else 0
    if limit < LEAST_LIMIT:
        raise InvalidInput(
            f"--record-limit is {text!r}; allowed: {LEAST_LIMIT // 10**6}MB or more, such as 50GB or 1.5TB"
        )
    if path is None or not _is_folder(path):
        raise InvalidInput(
            f"--record-limit needs --record with a folder, such as `--record recordings`; given: {path or 'nothing'} "
            "(a file that you name yourself is never removed)"
        )
    return limit


def _is_folder(path: Path) -> bool:
    return path.is_dir() or path.suffix != SUFFIX
