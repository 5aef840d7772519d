"""Converts a recorded scan between a folder and an MCAP recording."""

from __future__ import annotations

import json
import shutil
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy.typing as npt

from guara_perception.app.node.recorder import stance_message
from guara_perception.app.open_scan import open_scan, open_scans
from guara_perception.app.scan_folder import FORMAT, SCAN_FILE
from guara_perception.exceptions import FileFormatError, InvalidInput
from guara_perception.scan import Scan
from transport.recording import Frame, FrameReference, RecordingWriter, ScanRecord

Progress = Callable[[int, int], None]


def convert(
    source: str | Path, target: str | Path, *, step: int | None = None, progress: Progress | None = None
) -> Path:
    """Convert a folder into an .mcap file, or a scan of an .mcap file into a folder; whole or not at all.

    Args:
        source: folder or recording.
        target: what to write; a name that ends in .mcap becomes a recording, any other a folder.
        step: which scan of a recording that holds several.
        progress: called with (stripes done, stripes in all).

    Raises:
        InvalidInput: the target exists, or both are of one kind.
        MissingFile, FileFormatError: the source cannot be read.
    """
    source, target = Path(source), Path(target)
    if target.exists():
        raise InvalidInput(f"{target} exists; give another name, or remove it first")
    if source.is_dir() == (target.suffix != ".mcap"):
        raise InvalidInput(f"{source} -> {target}: one must be a folder and the other end in .mcap")
    if source.is_dir():
        _write_recording(open_scans(source), target, progress)
    else:
        _write_folder(open_scan(source, step), target, progress)
    return target


def _write_recording(scans: list[Scan], target: Path, progress: Progress | None) -> None:
    with RecordingWriter(target, robot=scans[0].robot, atomic=True) as writer:
        for scan in scans:
            writer.begin_scan(
                ScanRecord(
                    robot=scan.robot,
                    mode=scan.mode,
                    stamp=scan.stamp,
                    step=scan.step,
                    stance=stance_message(scan.stance),
                    calibration_hash=scan.calibration_hash or "",
                )
            )
            shared: dict[str, FrameReference] = {}
            for done, (stripe, on, off) in enumerate(scan.frames(), start=1):
                stamp = stripe.stamp or scan.stamp
                if stripe.off is not None and off is not None and stripe.off not in shared:
                    shared[stripe.off] = writer.add_frame(Frame(pixels=off, stamp=stamp), laser_on=False)
                reference = None if stripe.off is None else shared[stripe.off]
                writer.add_stripe(
                    stripe.index, stripe.mirror_angle, Frame(pixels=on, stamp=stamp), reference, stamp=stamp
                )
                if progress is not None:
                    progress(done, len(scan.stripes))
            end = None if scan.stance_end is None else stance_message(scan.stance_end)
            writer.end_scan(stance_end=end, stamp=scan.stamp)


def _write_folder(scan: Scan, target: Path, progress: Progress | None) -> None:
    if not target.parent.is_dir():
        raise InvalidInput(f"{target}: the folder {target.parent} does not exist, create it first")
    staging = Path(tempfile.mkdtemp(prefix=f".{target.name}-", dir=target.parent))
    try:
        stripes: list[dict[str, object]] = []
        names: dict[str, str] = {}
        for done, (stripe, on, off) in enumerate(scan.frames(), start=1):
            on_name = f"on_{stripe.index:03d}.png"
            _write_picture(staging / on_name, on)
            if stripe.off is not None and off is not None and stripe.off not in names:
                names[stripe.off] = f"off_{len(names):03d}.png"
                _write_picture(staging / names[stripe.off], off)
            entry: dict[str, object] = {
                "index": stripe.index,
                "mirror_angle": stripe.mirror_angle,
                "on": on_name,
                "off": None if stripe.off is None else names[stripe.off],
            }
            if stripe.stamp is not None:
                entry["stamp"] = stripe.stamp
            stripes.append(entry)
            if progress is not None:
                progress(done, len(scan.stripes))
        document = {
            "format": FORMAT,
            "robot": scan.robot,
            "mode": scan.mode,
            "stamp": scan.stamp or time.time_ns(),
            "step": scan.step,
            "stripes": stripes,
            "stance": scan.stance.to_dict(),
        }
        if scan.stance_end is not None:
            document["stance_end"] = scan.stance_end.to_dict()
        if scan.calibration_hash:
            document["calibration_hash"] = scan.calibration_hash
        (staging / SCAN_FILE).write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
        staging.chmod(0o755)
        staging.rename(target)
    except BaseException:
        shutil.rmtree(staging, ignore_errors=True)
        raise


def _write_picture(path: Path, picture: npt.NDArray[Any]) -> None:
    if not cv2.imwrite(str(path), picture):
        raise FileFormatError(f"{path}: the picture cannot be written; is the disk full?")
