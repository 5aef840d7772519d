"""Choice of the calibration of a recorded scan: given by the user, or stored with the scan."""

from __future__ import annotations

from pathlib import Path

from guara_perception.calibration.calibration import Calibration
from guara_perception.calibration.file import load_calibration, parse_calibration
from guara_perception.exceptions import InvalidInput, MissingFile

CALIBRATION_FILE = "calibration.json"


def carried_calibration(scan: str | Path) -> Calibration | None:
    """Calibration stored in a scan folder or attached to a recording; None if there is no calibration or no scan.

    Raises:
        FileFormatError: the calibration is not valid, or the recording cannot be read.
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
    """Load the calibration file `given`, or, if this is None, the calibration stored with the scan.

    Raises:
        InvalidInput: no file is given, and the scan has no calibration.
        MissingFile, FileFormatError: a file does not exist or cannot be read.
    """
    if given is not None:
        return load_calibration(given)
    carried = carried_calibration(scan)
    if carried is None:
        if not Path(scan).exists():
            raise MissingFile(f"{scan}: no such scan")
        raise InvalidInput(
            f"{scan} has no {CALIBRATION_FILE}: give the calibration of the rangefinder that recorded the scan (-c)"
        )
    return carried
