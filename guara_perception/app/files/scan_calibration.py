"""Calibration of a recorded scan: the stored one, or one that is given."""

from __future__ import annotations

from pathlib import Path

from guara_perception.calibration.calibration import Calibration
from guara_perception.calibration.file import load_calibration, parse_calibration
from guara_perception.exceptions import InvalidInput, MissingFile

CALIBRATION_FILE = "calibration.json"


def carried_calibration(scan: str | Path) -> Calibration | None:
    """Calibration stored in a scan folder or attached to a recording; None if there is none.

    Raises:
        FileFormatError: it is not a valid calibration, or the recording cannot be read.
    """
    from guara_perception.app.files.scan_recording import file_errors
    from transport.recording import open_recording

    scan = Path(scan)
    if scan.is_dir():
        path = scan / CALIBRATION_FILE
        return load_calibration(path) if path.is_file() else None
    if not scan.is_file():
        return None
    with file_errors(), open_recording(scan) as recording:
        text = recording.calibration
    return None if text is None else parse_calibration(text, f"{scan}: {CALIBRATION_FILE}")


def calibration_for(scan: str | Path, given: str | Path | None) -> Calibration:
    """Calibration that is given, or else the one stored with the scan.

    Raises:
        InvalidInput: there is neither.
        MissingFile, FileFormatError: the scan does not exist, or the calibration cannot be read.
    """
    if given is not None:
        return load_calibration(given)
    carried = carried_calibration(scan)
    if carried is None:
        if not Path(scan).exists():
            raise MissingFile(f"{scan}: no such scan")
        raise InvalidInput(
            f"{scan} carries no {CALIBRATION_FILE}: give the calibration of the rangefinder that recorded it (-c)"
        )
    return carried
