"""Access to the scans of an MCAP recording."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np
import numpy.typing as npt

from guara_perception.app.messages import add_samples, message_to_stance
from guara_perception.arrays import Float
from guara_perception.calibration.calibration import Calibration
from guara_perception.calibration.file import parse_calibration
from guara_perception.exceptions import FileFormatError, InvalidInput, errors_as
from guara_perception.files import existing_file
from guara_perception.images import decode_picture
from guara_perception.scan import Scan, ScanStripe
from kinematics import BodyTrack, KinematicsError, RobotModel
from transport import TerrainMessage, TransportError
from transport.recording import FrameReference, Recording, ScanRecord, StripeRecord, open_recording

# [ns] Joint samples are read from BEFORE_NS before the start of a scan to AFTER_NS after its last stripe.
BEFORE_NS, AFTER_NS = 5_000_000_000, 10_000_000_000


def open_recorded_scans(path: str | Path) -> list[Scan]:
    """Open the scans of a recording that have a laser-on frame, in recorded order.

    Frames are loaded on demand.

    Raises:
        MissingFile: the file does not exist.
        FileFormatError: the file is not a recording, has an invalid scan or grid, or is truncated (`guara convert` then
            makes it readable).
    """
    path = existing_file(path)
    with errors_as(FileFormatError, "", TransportError):
        recording = open_recording(path)
    with errors_as(FileFormatError, f"{path}: a recorded grid cannot be read", TransportError):
        withdrawn, walks = _read_grids(recording.scans, recording.terrains())
    calibration: Calibration | None = None
    if recording.calibration is not None:
        # A damaged calibration is reported only if it is used.
        with suppress(FileFormatError):
            calibration = parse_calibration(recording.calibration, str(path))
    return [
        _scan(recording, record, path, withdrawn.get(index, ""), walks.get(index, ""), calibration)
        for index, record in enumerate(recording.scans)
        # A pause that ended before its first stripe does not make the recording invalid.
        if any(stripe.on is not None for stripe in record.stripes)
    ]


def _read_grids(scans: Sequence[ScanRecord], grids: Iterable[TerrainMessage]) -> tuple[dict[int, str], dict[int, str]]:
    """Read why scans were withdrawn, and the epoch of their walk, by index of the scan.

    A withdrawn grid withdraws all scans of its pause, even if the map was confirmed before the robot moved, since the
    recording does not show the difference. If a gait restarted its count and repeated a step, the grid belongs to the
    last pause of that step whose scan began before the stamp of the grid.
    """
    withdrawn: dict[int, str] = {}
    walks: dict[int, str] = {}
    for grid in grids:
        of_step = [index for index, scan in enumerate(scans) if scan.step == grid.step]
        before = [index for index in of_step if scans[index].stamp <= grid.stamp]
        # If the clock was set back, all scans of the step may have later stamps. The grid is then assigned to all.
        last = before[-1:] or of_step
        while last and last[0] > 0 and scans[last[0] - 1].step == grid.step:
            last.insert(0, last[0] - 1)
        # Keep the epoch from an earlier grid: `last` may also contain scans of a previous walk that ended at this step.
        walks = dict.fromkeys(last, grid.epoch) | walks
        if grid.withdrawn:
            withdrawn |= dict.fromkeys(last, "; ".join(grid.health_reasons) or "no reason is given")
    for index, (earlier, later) in enumerate(itertools.pairwise(scans)):
        # A truncated recording may lack the grid of the later scan of a pause.
        if index in walks and (earlier.step, earlier.stance) == (later.step, later.stance):
            walks.setdefault(index + 1, walks[index])
    return withdrawn, walks


def _scan(
    recording: Recording, record: ScanRecord, path: Path, withdrawn: str, epoch: str, calibration: Calibration | None
) -> Scan:
    # A node records its instance name; its calibration names the robot, whose model processing needs.
    is_calibrated = calibration is not None and calibration.hash == record.calibration_hash
    source = f"{path} step {record.step}"
    names: dict[str, FrameReference] = {}

    def name(reference: FrameReference | None) -> str | None:
        if reference is None:
            return None
        text = f"{reference.topic}@{reference.stamp}"
        names[text] = reference
        return text

    def read_frame(text: str) -> npt.NDArray[np.generic]:
        with errors_as(FileFormatError, source, TransportError):
            frame = recording.frame(names[text])
        if frame.pixels is not None:
            return frame.pixels
        return decode_picture(frame.data or b"", f"{source}: frame {text}")

    # A stripe whose frame was lost is left out, so that its ground stays unknown.
    stripes = tuple(
        ScanStripe(
            stripe.index,
            stripe.mirror_angle,
            name(stripe.on) or "",
            name(stripe.off),
            stripe.stamp,
            name(stripe.dark),
            *_instant(stripe),
        )
        for stripe in record.stripes
        if stripe.on is not None
    )
    flashes = [stripe.flash for stripe in record.stripes if stripe.flash is not None]
    with errors_as(FileFormatError, source, InvalidInput, KinematicsError):
        stance = message_to_stance(record.stance)

        def read_track(robot: RobotModel, transform_camera_to_base: Float) -> BodyTrack:
            track = BodyTrack(robot, stance, transform_camera_to_base=transform_camera_to_base)
            until = max(stripe.stamp for stripe in record.stripes) + AFTER_NS
            with errors_as(FileFormatError, source, TransportError):
                for batch in recording.stance_stream(record.stamp - BEFORE_NS, until):
                    add_samples(track, robot, batch, flashes[0].begin)
            return track

        return Scan(
            robot=calibration.robot if calibration is not None and is_calibrated else record.robot,
            mode=record.mode,
            stamp=record.stamp,
            step=record.step,
            stripes=stripes,
            stance=stance,
            stance_end=None if record.stance_end is None else message_to_stance(record.stance_end),
            calibration_hash=record.calibration_hash or None,
            source=source,
            read_frame=read_frame,
            withdrawn=withdrawn,
            dark_after=tuple(stripe.index for stripe in record.stripes if stripe.is_dark_due),
            camera_identity="" if calibration is None else calibration.camera.identity,
            read_track=read_track if flashes else None,
            epoch=epoch,
        )


def _instant(stripe: StripeRecord) -> tuple[float, float]:
    """Time of a stripe's flash since BEGIN and its standard deviation [s]; NaN and 0 if not recorded."""
    if stripe.flash is None:
        return math.nan, 0.0
    return (stripe.flash.stamp - stripe.flash.begin) * 1e-9, stripe.flash.sigma * 1e-9
