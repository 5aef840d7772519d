"""Conversion of recorded scans between folders and MCAP recordings."""

from __future__ import annotations

from pathlib import Path

from guara_perception.app.files.open_scan import carried_calibration, open_scan, open_scans
from guara_perception.app.files.scan_folder import ScanFolderWriter
from guara_perception.app.messages import stance_to_message
from guara_perception.calibration.calibration import Calibration
from guara_perception.calibration.file import load_calibration, to_json
from guara_perception.exceptions import CalibrationMismatch, InvalidInput
from guara_perception.progress import Progress
from guara_perception.scan import Scan, frame_reader
from transport.recording import FrameRecord, FrameReference, RecordingWriter, ScanRecord


def convert(
    source: str | Path,
    target: str | Path,
    *,
    step: int | None = None,
    calibration: str | Path | None = None,
    progress: Progress | None = None,
) -> Path:
    """Convert a scan folder to an .mcap file, or a scan of an .mcap file to a folder. The target is written atomically.

    Args:
        source: scan folder or recording.
        target: path to write; a recording if it ends in .mcap, else a folder.
        step: step of the pause whose scan is converted, for a recording with several pauses.
        calibration: calibration file to store with the scan; None = the calibration that the source carries, if any.
        progress: called with (stripes done, total number of stripes), or None.

    Returns:
        `target`.

    Raises:
        InvalidInput: the target exists, source and target are of the same kind, the recording has no scan of the pause
            or several pauses to choose from (see `open_scan`), the parent folder of a target folder does not exist, or
            a scan folder cannot represent the scan because its grid was withdrawn or it has a joint stream.
        CalibrationMismatch: the given calibration is of another robot than the scan.
        MissingFile, FileFormatError: the source or the calibration cannot be read.
        transport.RecordingError: the recording cannot be written.
    """
    source, target = Path(source), Path(target)
    if target.exists():
        raise InvalidInput(f"{target} exists; give another name, or remove it first")
    if source.is_dir() == (target.suffix != ".mcap"):
        raise InvalidInput(f"{source} -> {target}: one must be a folder, and the other must end in .mcap")
    scans = open_scans(source) if source.is_dir() else [open_scan(source, step)]
    if calibration is None:
        stored = carried_calibration(source)
    else:
        stored = load_calibration(calibration)
        if stored.robot != scans[0].robot:
            raise CalibrationMismatch(
                f"{calibration} is of robot {stored.robot!r}, but {source} of {scans[0].robot!r}: give the calibration "
                f"of the scan's rangefinder"
            )
    if source.is_dir():
        _write_recording(scans, stored, target, progress)
    else:
        _write_folder(scans[0], stored, target, progress)
    return target


def _write_recording(
    scans: list[Scan], calibration: Calibration | None, target: Path, progress: Progress | None
) -> None:
    text = None if calibration is None else to_json(calibration).encode()
    with RecordingWriter(target, robot=scans[0].robot, calibration=text, atomic=True) as writer:
        for scan in scans:
            writer.begin_scan(
                ScanRecord(
                    robot=scan.robot,
                    mode=scan.mode,
                    stamp=scan.stamp,
                    step=scan.step,
                    stance=stance_to_message(scan.stance),
                    calibration_hash=scan.calibration_hash or "",
                )
            )
            shared: dict[str, FrameReference] = {}
            read = frame_reader(scan)
            for done, stripe in enumerate(scan.stripes, start=1):
                pair, stamp = read(stripe), stripe.stamp or scan.stamp
                if stripe.off is not None and pair.off is not None and stripe.off not in shared:
                    shared[stripe.off] = writer.add_frame(FrameRecord(pixels=pair.off, stamp=stamp), laser_on=False)
                reference = None if stripe.off is None else shared[stripe.off]
                on = FrameRecord(pixels=pair.on, stamp=stamp)
                writer.add_stripe(stripe.index, stripe.mirror_angle, on, reference, stamp=stamp)
                if pair.dark is not None or stripe.index in scan.dark_after:
                    dark = None if pair.dark is None else FrameRecord(pixels=pair.dark, stamp=stamp)
                    writer.add_dark(stripe.index, stripe.mirror_angle, dark, stamp)
                if progress is not None:
                    progress(done, len(scan.stripes))
            end = None if scan.stance_end is None else stance_to_message(scan.stance_end)
            writer.end_scan(stance_end=end, stamp=scan.stamp)


def _write_folder(scan: Scan, calibration: Calibration | None, target: Path, progress: Progress | None) -> None:
    # scan.json has no field for a withdrawal or a joint stream.
    scan.refuse_withdrawn()
    if scan.read_track is not None:
        raise InvalidInput(
            f"{scan.source}: the scan has a joint stream, which a scan folder cannot contain: use the recording"
        )
    with ScanFolderWriter(target) as writer:
        read = frame_reader(scan)
        for done, stripe in enumerate(scan.stripes, start=1):
            pair, angle = read(stripe), stripe.mirror_angle
            writer.add(stripe.index, angle, pair.on, pair.off, off_key=stripe.off, stamp=stripe.stamp, dark=pair.dark)
            if progress is not None:
                progress(done, len(scan.stripes))
        writer.finish(
            robot=scan.robot,
            mode=scan.mode,
            stamp=scan.stamp,
            step=scan.step,
            stance=scan.stance,
            stance_end=scan.stance_end,
            calibration_hash=scan.calibration_hash,
            calibration=calibration,
            dark_after=scan.dark_after,
            camera_identity=scan.camera_identity,
        )
