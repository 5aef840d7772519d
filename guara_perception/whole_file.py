"""Writes files whole or not at all: beside the target first, then one rename."""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from guara_perception.exceptions import InvalidInput, MissingFile


def check_target(path: str | Path) -> Path:
    """Refuse an output path that cannot be written, before work is spent on what goes there.

    Raises:
        MissingFile: the folder of `path` does not exist.
        InvalidInput: `path` is itself a folder.
    """
    path = Path(path)
    if path.is_dir():
        raise InvalidInput(f"{path} is a folder, give the name of a file")
    if not path.parent.is_dir():
        raise MissingFile(f"{path}: the folder {path.parent} does not exist, create it first")
    return path


@contextmanager
def whole_file(path: str | Path) -> Iterator[Path]:
    """Give a temporary path beside `path`; on success it becomes `path`, on any error it vanishes.

    The temporary name keeps the suffix, because some writers choose the format by it.

    Raises:
        MissingFile: the folder of `path` does not exist.
        InvalidInput: `path` is itself a folder.
    """
    path = check_target(path)
    temporary = path.with_name(f".{path.stem}-{secrets.token_hex(4)}{path.suffix}")
    # Created here, so that it is ours alone, with the permissions that any new file of this user gets.
    os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
    try:
        yield temporary
        _to_disk(temporary)
        os.replace(temporary, path)
    except OSError as error:
        # The error of a full disk names no file, or the temporary one, which the user does not know.
        if error.filename is None or os.fspath(error.filename) == os.fspath(temporary):
            raise OSError(error.errno, error.strerror, str(path)) from error
        raise
    finally:
        temporary.unlink(missing_ok=True)


def _to_disk(path: Path) -> None:
    """Without this a power cut soon after the rename can leave an empty file under the new name."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
