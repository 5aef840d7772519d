"""Description of the files and folders that this project writes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from guara_perception.app.files.calibration_session import SESSION_FILE
from guara_perception.app.files.recording import open_recording
from guara_perception.app.files.scan_folder import CALIBRATION_FILE, SCAN_FILE, open_scan_folder
from guara_perception.app.summary import facts
from guara_perception.calibration.file import load_calibration
from guara_perception.exceptions import InvalidInput, MissingFile, errors_as
from guara_perception.fields import read_json
from guara_perception.terrain.file import load_terrain
from kinematics import KinematicsError, load_robot

KINDS = "a grid (.npz), a recording (.mcap), a calibration (.json), a scan folder, a session folder or a robot folder"


def describe_file(path: str | Path) -> dict[str, Any]:
    """Describe the contents of a file or folder as plain values; the entry "kind" is its type.

    Raises:
        MissingFile: the path, or a frame named in a scan folder, does not exist.
        InvalidInput: the file or folder is none of `KINDS`, or a robot folder cannot be loaded.
        FileFormatError: the file, or one in the folder, is damaged.
        UnsafeGrid: a recorded grid violates the safety invariant.
    """
    path = Path(path)
    if not path.exists():
        raise MissingFile(f"{path}: no such file or folder")
    if path.is_dir():
        for name, describe in FOLDERS.items():
            if (path / name).is_file():
                return describe(path)
    else:
        describe_suffix = FILES.get(path.suffix)
        if describe_suffix is not None:
            return describe_suffix(path)
    raise InvalidInput(f"{path}: unknown kind of file; it must be {KINDS}")


def _grid(path: Path) -> dict[str, Any]:
    return {"kind": "grid", **facts(load_terrain(path))}


def _recording(path: Path) -> dict[str, Any]:
    with open_recording(path) as recording:
        grids = {extent: [grid.step for grid in recording.grids(extent)] for extent in ("footprint", "map")}
        return {
            "kind": "recording",
            "robot": recording.scans[0].robot if recording.scans else None,
            "scans": [{"step": s.step, "mode": s.mode, "stripes": len(s.stripes)} for s in recording.scans],
            "grids": grids,
            "stance_pauses": sum(1 for _ in recording.stances()),
            "calibration_hash": None if recording.calibration is None else recording.calibration.hash,
        }


def _calibration(path: Path) -> dict[str, Any]:
    calibration = load_calibration(path)
    return {
        "kind": "calibration",
        "robot": calibration.robot,
        "verdict": calibration.quality.get("verdict"),
        "reasons": list(calibration.quality.get("reasons", ())),
        "created": calibration.created,
        "hash": calibration.hash,
        "picture_size": list(calibration.camera.size),
        "stripes": len(calibration.stripes),
        "has_covariance": bool(calibration.covariance),
    }


def _scan(path: Path) -> dict[str, Any]:
    scan = open_scan_folder(path)
    return {
        "kind": "scan",
        "robot": scan.robot,
        "mode": scan.mode,
        "step": scan.step,
        "stamp": scan.stamp,
        "stripes": len(scan.stripes),
        "laser_off_frames": len({stripe.off for stripe in scan.stripes if stripe.off is not None}),
        "dark_flashes": len(scan.dark_after),
        "calibration_hash": scan.calibration_hash,
        "carries_calibration": (path / CALIBRATION_FILE).is_file(),
    }


def _session(path: Path) -> dict[str, Any]:
    session = read_json(path / SESSION_FILE)
    return {
        "kind": "calibration session",
        "robot": session.text("robot"),
        "board_images": len(session.data.get("board_images", ())),
        "plates": [plate.number("height", -10, 10) for plate in session.items("plates")],
    }


def _robot(path: Path) -> dict[str, Any]:
    with errors_as(InvalidInput, path, KinematicsError):
        robot = load_robot(path)
    return {"kind": "robot", "robot": robot.name, "legs": list(robot.legs), "joints": len(robot.joint_names)}


FOLDERS = {SCAN_FILE: _scan, SESSION_FILE: _session, "robot.toml": _robot}
FILES = {".npz": _grid, ".mcap": _recording, ".json": _calibration}
