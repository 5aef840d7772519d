"""Opens the scans of an MCAP recording."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from guara_perception.app.messages import message_to_stance
from guara_perception.bounded_files import decode_picture
from guara_perception.exceptions import FileFormatError, InvalidInput, MissingFile
from guara_perception.scan import Scan, ScanStripe
from kinematics import KinematicsError
from transport import TransportError
from transport.recording import FrameReference, Recording, ScanRecord, open_recording


def open_recorded_scans(path: str | Path) -> list[Scan]:
    """All scans of a recording, in order; frames are read when they are asked for.

    Raises:
        MissingFile: no such file.
        FileFormatError: not a recording, cut (then `guara recover` helps), or a scan in it is not valid.
    """
    path = Path(path)
    if not path.is_file():
        raise MissingFile(f"{path}: no such file")
    try:
        recording = open_recording(path)
    except TransportError as error:
        raise FileFormatError(str(error)) from None
    return [_scan(recording, record, path) for record in recording.scans]


def _scan(recording: Recording, record: ScanRecord, path: Path) -> Scan:
    source = f"{path} step {record.step}"
    names: dict[str, FrameReference] = {}

    def name(reference: FrameReference | None) -> str | None:
        if reference is None:
            return None
        text = f"{reference.topic}@{reference.stamp}"
        names[text] = reference
        return text

    def read_frame(text: str) -> npt.NDArray[np.generic]:
        try:
            frame = recording.frame(names[text])
        except TransportError as error:
            raise FileFormatError(f"{source}: {error}") from None
        if frame.pixels is not None:
            return frame.pixels
        return decode_picture(frame.data or b"", f"{source}: frame {text}")

    # A stripe whose frame was lost has nothing to be read: it is left out, and so stays unknown.
    stripes = tuple(
        ScanStripe(stripe.index, stripe.mirror_angle, name(stripe.on) or "", name(stripe.off), stripe.stamp)
        for stripe in record.stripes
        if stripe.on is not None
    )
    try:
        return Scan(
            robot=record.robot,
            mode=record.mode,
            stamp=record.stamp,
            step=record.step,
            stripes=stripes,
            stance=message_to_stance(record.stance),
            stance_end=None if record.stance_end is None else message_to_stance(record.stance_end),
            calibration_hash=record.calibration_hash or None,
            source=source,
            read_frame=read_frame,
        )
    except (InvalidInput, KinematicsError) as error:
        raise FileFormatError(f"{source}: {error}") from None
