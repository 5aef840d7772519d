"""Atomic creation of folders, and of files that only their owner can read."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

from transport.exceptions import SecurityError


def write_file(path: Path, data: bytes, *, private: bool = False) -> None:
    """Create a file and flush it to the disk; a private one is never readable by others."""
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600 if private else 0o644)
    with os.fdopen(descriptor, "wb") as file:
        file.write(data)
        os.fsync(file.fileno())


def create_folder(target: Path, write: Callable[[Path], None]) -> None:
    """Create a folder atomically: `write` fills a temporary folder next to it, which is then renamed.

    Args:
        target: folder to create; an empty one is replaced.
        write: function that writes the files into the given folder.

    Raises:
        SecurityError: the folder cannot be written, or exists and is not empty.
    """
    staging: Path | None = None
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        staging = Path(tempfile.mkdtemp(prefix=f".{target.name}-", dir=target.parent))
        filled = staging / target.name
        filled.mkdir()
        write(filled)
        if target.exists():
            target.rmdir()
        filled.rename(target)
    except OSError as error:
        raise SecurityError(f"cannot write {target}: {error.strerror}") from error
    finally:
        if staging is not None:
            shutil.rmtree(staging, ignore_errors=True)
