"""Atomic creation of folders, and creation of files, which may be private to their owner."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from pathlib import Path

from transport.exceptions import SecurityError, errors_as


def write_file(path: Path, data: bytes, *, private: bool = False) -> None:
    """Create a file and flush it to the disk; a `private` file is never readable by others."""
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600 if private else 0o644)
    with os.fdopen(descriptor, "wb") as file:
        file.write(data)
        os.fsync(file.fileno())


def create_folder(target: Path, write: Callable[[Path], None]) -> None:
    """Create a folder atomically: `write` fills a temporary folder next to it, which is then renamed.

    Args:
        target: folder to create; an existing empty folder is replaced.
        write: function that writes the files into the folder that it receives.

    Raises:
        SecurityError: the folder cannot be written, or exists and is not empty.
    """
    with errors_as(SecurityError, f"cannot write {target}"):
        target.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f".{target.name}-", dir=target.parent) as staging:
            filled = Path(staging) / target.name
            filled.mkdir()
            write(filled)
            if target.exists():
                target.rmdir()
            filled.rename(target)
