"""Access to recorded scans in folders and MCAP recordings, and to the calibrations stored with them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from guara_perception.app.files.scan_folder import CALIBRATION_FILE, open_scan_folder
from guara_perception.calibration.calibration import Calibration, format_indices
from guara_perception.calibration.file import load_calibration, parse_calibration
from guara_perception.exceptions import FileFormatError, InvalidInput, MissingFile, errors_as
from guara_perception.scan import Scan


def open_scan(path: str | Path, step: int | None = None, *, missing_ok: bool = False) -> Scan:
    """Open one recorded scan from a scan folder or an .mcap recording.

    Args:
        path: scan folder or recording.
        step: step of the pause to open; None = the only one.
        missing_ok: also open a folder with missing frames, whose ground stays unknown.

    Raises:
        MissingFile: the path does not exist, or a frame is missing from the folder and `missing_ok` is False.
        FileFormatError: the file or folder is not a valid scan.
        InvalidInput: `path` is neither a folder nor an .mcap file, contains no scan or none of this step, contains
            several steps while `step` is None, or contains the step in several walks.
    """
    scans = last_of_each_pause(open_scans(path, missing_ok=missing_ok))
    chosen = scans if step is None else [scan for scan in scans if scan.step == step]
    if len(chosen) == 1:
        return chosen[0]
    if not scans:
        raise InvalidInput(f"{path}: contains no scan")
    if chosen and len({scan.step for scan in chosen}) == 1:
        walks = ", ".join(repr(scan.epoch) if scan.epoch else f"unnamed (scan at {scan.stamp} ns)" for scan in chosen)
        raise InvalidInput(
            f"{path}: step {chosen[0].step} is in {len(chosen)} walks: {walks}; `guara replay` processes all"
        )
    wanted = "" if step is None else f"no scan of step {step}; "
    held = format_indices(tuple(sorted({scan.step for scan in scans})))
    raise InvalidInput(f"{path}: {wanted}contains scans of steps {held}; select one with --step")


def last_of_each_pause(scans: Sequence[Scan]) -> list[Scan]:
    """Keep the last of successive scans of one pause, such as the complete scan that follows a coarse one."""
    pauses = [(scan.epoch, scan.step) for scan in scans]
    return [scan for scan, pause, after in zip(scans, pauses, [*pauses, None][1:], strict=True) if pause != after]


def open_scans(path: str | Path, *, missing_ok: bool = False) -> list[Scan]:
    """Open the scan of a folder or all scans of an .mcap recording, in recorded order.

    Raises:
        MissingFile: the path does not exist, or a frame is missing from the folder and `missing_ok` is False.
        FileFormatError: the file or folder is not a valid scan.
        InvalidInput: `path` is neither a folder nor an .mcap file.
    """
    path = Path(path)
    if not path.exists():
        raise MissingFile(f"{path}: no such scan")
    if path.is_dir():
        return [open_scan_folder(path, missing_ok=missing_ok)]
    if path.suffix != ".mcap":
        raise InvalidInput(f"{path}: not a scan; allowed: a folder with scan.json, or a file that ends in .mcap")
    from guara_perception.app.files.scan_recording import open_recorded_scans

    return open_recorded_scans(path)


def carried_calibration(scan: str | Path) -> Calibration | None:
    """Calibration stored in a scan folder or attached to a recording; None if there is no calibration or no scan.

    Raises:
        FileFormatError: the calibration is not valid, or the recording cannot be read.
    """
    from transport import TransportError
    from transport.recording import open_recording

    scan = Path(scan)
    if scan.is_dir():
        path = scan / CALIBRATION_FILE
        return load_calibration(path) if path.is_file() else None
    if not scan.is_file():
        return None
    with errors_as(FileFormatError, "", TransportError), open_recording(scan) as recording:
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
