"""Opening of recorded scans, from folders or MCAP recordings."""

from __future__ import annotations

from pathlib import Path

from guara_perception.app.files.scan_folder import open_scan_folder
from guara_perception.calibration.calibration import format_indices
from guara_perception.exceptions import InvalidInput, MissingFile
from guara_perception.scan import Scan


def open_scan(path: str | Path, step: int | None = None, *, missing_ok: bool = False) -> Scan:
    """Open one recorded scan: a folder, or an .mcap file.

    Args:
        path: scan folder or recording.
        step: pause to open, for a recording that has several.
        missing_ok: open a folder although some of its frames are missing; their ground stays unknown.

    Raises:
        MissingFile: the path does not exist.
        FileFormatError: not a scan; the message names file and field.
        InvalidInput: neither a folder nor an .mcap file; or the recording has no scan, none of this step, or several
            while `step` is None.
    """
    scans = open_scans(path, missing_ok=missing_ok)
    # A pause may have two scans, a coarse one and the same with intermediate stripes added: the later one is taken.
    scans = list({scan.step: scan for scan in scans}.values())
    chosen = scans if step is None else [scan for scan in scans if scan.step == step]
    if len(chosen) == 1:
        return chosen[0]
    if not scans:
        raise InvalidInput(f"{path}: it holds no scan")
    wanted = "" if step is None else f"step is {step}; "
    held = format_indices(tuple(sorted(scan.step for scan in scans)))
    raise InvalidInput(f"{path}: {wanted}it holds scans of the steps {held}: give one of these (--step)")


def open_scans(path: str | Path, *, missing_ok: bool = False) -> list[Scan]:
    """Open all scans of a folder (one) or of an .mcap recording, in recorded order; errors as in `open_scan`."""
    path = Path(path)
    if not path.exists():
        raise MissingFile(f"{path}: no such scan")
    if path.is_dir():
        return [open_scan_folder(path, missing_ok=missing_ok)]
    if path.suffix != ".mcap":
        raise InvalidInput(f"{path}: a scan is a folder that holds scan.json, or a file that ends in .mcap")
    from guara_perception.app.files.scan_recording import open_recorded_scans

    return open_recorded_scans(path)
