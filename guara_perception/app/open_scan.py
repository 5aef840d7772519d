"""`open_scan`: a recorded scan, whatever it is stored in."""

from __future__ import annotations

from pathlib import Path

from guara_perception.app.scan_folder import open_scan_folder
from guara_perception.exceptions import MissingFile
from guara_perception.scan import Scan


def open_scan(path: str | Path) -> Scan:
    """Open a recorded scan folder.

    Raises:
        MissingFile: nothing there.
        FileFormatError: not a scan; the message names file and field.
    """
    path = Path(path)
    if not path.exists():
        raise MissingFile(f"{path}: no such scan")
    return open_scan_folder(path)
