"""Writes live scans, their grids and the stance pauses into one MCAP file."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Self

import cv2

from guara_perception.arrays import Image
from guara_perception.calibration.calibration import Calibration
from guara_perception.calibration.file import to_json
from kinematics import Stance
from transport import StanceMessage, TerrainMessage, TransportError
from transport.recording import FrameRecord, FrameReference, RecordingWriter, ScanRecord

if TYPE_CHECKING:
    from drivers import StripeCapture

JPEG_444 = cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444


def stance_message(stance: Stance) -> StanceMessage:
    """A stance as it stands in messages."""
    return StanceMessage(
        joint_positions=stance.joint_positions,
        support_feet=stance.support_feet,
        gravity_in_base=stance.gravity_in_base,
    )


class ScanRecorder:
    """An MCAP file that grows with every scan; what was acknowledged survives the end of the process."""

    def __init__(
        self, path: str | Path, *, robot: str, calibration: Calibration, jpeg_quality: int | None = None
    ) -> None:
        """Create the file.

        Args:
            path: new .mcap file.
            robot: instance name.
            calibration: in use; attached to the file.
            jpeg_quality: 1 ... 100 compresses frames with loss, to a tenth of the size; None keeps every bit.

        Raises:
            transport.RecordingError: it exists, or cannot be written.
        """
        self._robot, self._hash, self._quality = robot, calibration.hash, jpeg_quality
        self._writer = RecordingWriter(path, robot=robot, calibration=to_json(calibration).encode())

    def __enter__(self) -> Self:
        """The recorder itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Write the index."""
        self._writer.close()

    def begin(self, step: int, mode: str, stance: Stance) -> ScanRecording:
        """Start a scan."""
        record = ScanRecord(
            robot=self._robot,
            mode=mode,
            stamp=time.time_ns(),
            step=step,
            stance=stance_message(stance),
            calibration_hash=self._hash,
        )
        return ScanRecording(self._writer, record, self._quality)

    def add_terrains(self, terrains: Sequence[TerrainMessage]) -> None:
        """Add grids that came after their scan had ended, as when it is withdrawn; when this returns they are safe.

        Raises:
            transport.RecordingError, OSError: as of `ScanRecording.finish`.
        """
        for terrain in terrains:
            self._writer.add_terrain(terrain)


class ScanRecording:
    """One scan being recorded; an error of the disk is kept until `finish`, so that the scan itself goes on."""

    def __init__(self, writer: RecordingWriter, record: ScanRecord, jpeg_quality: int | None) -> None:
        """Begin; made by `ScanRecorder.begin`."""
        self._writer, self._record, self._quality = writer, record, jpeg_quality
        self._error: Exception | None = None
        self._last_off: tuple[int, FrameReference] | None = None
        self._stripes: list[tuple[int, float, FrameReference | None, FrameReference | None, int]] = []
        self._is_open = self._is_full = False
        self._guarded(lambda: writer.begin_scan(record))
        self._is_open = self._error is None

    def add(self, capture: StripeCapture) -> None:
        """Record one stripe; an off frame that several stripes share is written once."""
        if self._error is None and self._is_open and not self._is_full:
            self._guarded(lambda: self._add(capture))

    def extend(self, mode: str | None) -> None:
        """The scan goes on with the stripes between.

        Args:
            mode: of the whole scan, which is then recorded as a second one of this pause over the frames that are
                already there; None when it will not be whole: what follows is then not recorded as frames.
        """
        if mode is None or self._error is not None:
            self._is_full = True
            return
        self._guarded(lambda: self._begin_again(mode))

    def _begin_again(self, mode: str) -> None:
        self._writer.end_scan(stamp=time.time_ns())
        self._writer.begin_scan(dataclasses.replace(self._record, mode=mode))
        for index, angle, on, off, stamp in self._stripes:
            self._writer.add_stripe(index, angle, on, off, stamp=stamp)

    def _add(self, capture: StripeCapture) -> None:
        now = time.time_ns()
        off: FrameReference | None = None
        if capture.off is not None:
            if self._last_off is None or self._last_off[0] != id(capture.off):
                reference = self._writer.add_frame(self._frame(capture.off, now), laser_on=False)
                self._last_off = (id(capture.off), reference)
            off = self._last_off[1]
        on = None
        if capture.on is not None:
            on = self._writer.add_frame(self._frame(capture.on, now), laser_on=True)
        self._writer.add_stripe(capture.index, capture.mirror_angle, on, off, stamp=now)
        self._stripes.append((capture.index, capture.mirror_angle, on, off, now))

    def _guarded(self, action: Callable[[], None]) -> None:
        try:
            action()
        except (TransportError, OSError) as error:
            self._error = error

    def _frame(self, pixels: Image, stamp: int) -> FrameRecord:
        if self._quality is None:
            return FrameRecord(pixels=pixels, stamp=stamp)
        # 4:4:4, since the red stripe lives in the colour planes that 4:2:0 would halve.
        options = (cv2.IMWRITE_JPEG_QUALITY, self._quality, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, JPEG_444)
        return FrameRecord(data=cv2.imencode(".jpg", pixels, options)[1].tobytes(), format="jpeg", stamp=stamp)

    def finish(self, terrains: tuple[TerrainMessage, ...], stance_end: Stance | None) -> None:
        """End the scan and add its grids; when this returns they are safe.

        Raises:
            transport.RecordingError, OSError: what went wrong meanwhile, a full disk for instance.
        """
        if self._is_open:
            self._is_open = False
            end = None if stance_end is None else stance_message(stance_end)
            self._writer.end_scan(stance_end=end, stamp=time.time_ns())
        if self._error is not None:
            raise self._error
        for terrain in terrains:
            self._writer.add_terrain(terrain)

    def abandon(self) -> None:
        """End a scan that came to nothing, so that the next can begin."""
        if self._is_open:
            self._is_open = False
            self._guarded(lambda: self._writer.end_scan(stamp=time.time_ns()))
