"""Writes files whole or not at all: beside the target first, then one rename."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from guara_perception.exceptions import MissingFile


@contextmanager
def whole_file(path: str | Path) -> Iterator[Path]:
    """Give a temporary path beside `path`; on success it becomes `path`, on any error it vanishes.

    The temporary name keeps the suffix, because some writers choose the format by it.

    Raises:
        MissingFile: the folder of `path` does not exist.
    """
    path = Path(path)
    if not path.parent.is_dir():
        raise MissingFile(f"{path}: the folder {path.parent} does not exist, create it first")
    handle, name = tempfile.mkstemp(prefix=f".{path.stem}-", suffix=path.suffix, dir=path.parent)
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        os.chmod(temporary, 0o666 & ~_umask())
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
