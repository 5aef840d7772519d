"""Recorder of live scans: writes frames, stances and grids to MCAP files on its own thread."""

from __future__ import annotations

import dataclasses
import itertools
import logging
import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2

from guara_perception.app.files.recording_files import RecordingFiles
from guara_perception.app.messages import stance_to_message
from guara_perception.app.scene.scene import Named, Scene
from guara_perception.arrays import Image
from guara_perception.calibration.calibration import Calibration
from guara_perception.calibration.file import to_json
from kinematics import Stance
from transport import (
    Health,
    Outbox,
    PausePhase,
    ReceiveTimeout,
    StanceMessage,
    StancePause,
    StanceStream,
    StatusItem,
    TerrainMessage,
    clock,
)
from transport.exceptions import RecordingError
from transport.recording import FlashRecord, FrameRecord, FrameReference, RecordingWriter, ScanRecord, StripeRecord

if TYPE_CHECKING:
    from drivers import StripeCapture
    from guara_perception.ranging.stripe_points import StripePoints

logger = logging.getLogger(__name__)
JPEG_444 = cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444
# Largest total size of the frames that may wait for the disk [byte]: 614 single-channel frames of 640 x 512 pixels.
MAXIMUM_WAITING = 192 * 1024 * 1024
# Longest wait for the disk when the recorder closes [s].
CLOSE_TIMEOUT_S = 30.0


class ScanRecorder(AbstractContextManager["ScanRecorder"]):
    """MCAP recorder of scans; data already written survive a crash of the process.

    An existing file is never overwritten: the recording goes to a new file. In a folder, another file is started
    between two scans when the current file is full; each file can be opened on its own.

    No scan waits for the disk: copies of its frames and its grid are written on another thread. Data that a slow or
    full disk does not accept are missing from the recording, never from the scan; `status_item` reports lost scans.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        robot: str,
        calibration: Calibration,
        jpeg_quality: int | None = None,
        scene: Scene | None = None,
        limit: int | None = None,
        first: int = 0,
    ) -> None:
        """Create the file.

        Args:
            path: file name that ends with .mcap, or a folder; see `RecordingFiles`.
            robot: instance name.
            calibration: calibration in use; attached to the file.
            jpeg_quality: 1 ... 100 stores frames as JPEG of this quality (a ninth of the size at 90); None = lossless.
            scene: source of the messages for 3-D viewers: robot, transforms, clouds, markers, ROS grids; None = none.
            limit: largest total size of the files in a folder [byte], kept by removing the oldest; None = no limit.
            first: lowest step whose scans are recorded.

        Raises:
            transport.RecordingError: the folder or the file cannot be created.
        """
        self._robot, self._hash, self._quality = robot, calibration.hash, jpeg_quality
        self._files = RecordingFiles(Path(path), robot, limit)
        self._calibration = to_json(calibration).encode()
        self._scene = scene
        self._first = first
        self._counted = threading.Lock()
        self._recorded = self._lost = 0
        self._problem = self._trouble = ""
        self._make_room()
        self.writer = self._open()
        self._outbox = Outbox()
        self._tasks = itertools.count()
        self._waiting, self._is_closed = 0, False
        self._add_later("the robot description", self._add_robot)

    def __exit__(self, *error: object) -> None:
        """Write the waiting data and close the file.

        If the data cannot be written within CLOSE_TIMEOUT_S, log an error and leave the file incomplete.
        """
        is_written = self.flush(CLOSE_TIMEOUT_S)
        self._is_closed = True
        if is_written:
            self._outbox.close()
            self.writer.close()
        else:
            logger.error("%s: disk too slow, unwritten data are lost; `guara convert` recovers the rest", self.path)

    @property
    def path(self) -> Path:
        """File being written."""
        return self.writer.path

    @property
    def cut(self) -> list[Path]:
        """Incomplete files of earlier recordings, oldest first; `guara convert` makes them readable."""
        return [path for path in self._files.cut() if path != self.path]

    def begin(self, step: int, mode: str, stance: Stance) -> ScanRecording | None:
        """Start recording a scan; return None if its step is earlier than `first`."""
        if step < self._first:
            return None
        self.post(0, self._next_file)
        stamp = time.time_ns()
        record = ScanRecord(
            robot=self._robot,
            mode=mode,
            stamp=stamp,
            step=step,
            stance=stance_to_message(stance),
            calibration_hash=self._hash,
        )
        self._draw(f"the stance of step {step}", lambda scene: scene.of_stance(stance, stamp))
        return ScanRecording(self, record, self._quality)

    def add_terrains(self, step: int, terrains: Sequence[TerrainMessage]) -> None:
        """Add grids that are published after their scan has ended, for instance withdrawals, without blocking."""
        if step < self._first:
            return

        def add() -> None:
            try:
                self.write_terrains(terrains)
            except Exception as error:
                self.ended(step, str(error))

        self.post(0, add)

    def add_stance(self, pause: StancePause) -> None:
        """Add an announcement of a stance pause without blocking."""
        if pause.phase is PausePhase.BEGIN:
            self.post(0, self._next_file)
        self._add_later("a stance", lambda: self.writer.add_stance_pause(pause))

    def add_stream(self, batch: StanceStream) -> None:
        """Add a batch of joint samples without blocking."""
        self._add_later("a batch of joint samples", lambda: self.writer.add_stance_stream(batch))

    def add_status(self, payload: bytes | bytearray) -> None:
        """Add the payload of a status message of the node without blocking."""
        self._add_later("a status", lambda: self.writer.add_status(payload))

    def add_points(self, points: Mapping[int, StripePoints], stamp: int) -> None:
        """Add the points of a scan's stripes, by stripe index, without blocking. The arrays must not change later."""
        kept = dict(points)
        self._draw("the points of a scan", lambda scene: scene.of_points(kept, stamp))

    def add_range_images(self, step: int, make: Callable[[], Mapping[str, Any]]) -> None:
        """Add the range images of a scan without blocking.

        `make` returns their messages by topic; it is called on the recorder's thread.
        """
        if step >= self._first:
            self._draw("the range images of a scan", lambda scene: make().items())

    def write_terrains(self, terrains: Sequence[TerrainMessage]) -> None:
        """Write grids, then their messages for viewers; called on the recorder's thread."""
        for terrain in terrains:
            self.writer.add_terrain(terrain)
        if self._scene is not None:
            for terrain in terrains:
                self.writer.add_messages(self._scene.of_grid(terrain))

    def flush(self, timeout: float) -> bool:
        """Wait until all data are written or lost; return False after `timeout` [s]."""
        try:
            self._outbox.flush(timeout)
        except ReceiveTimeout:
            return False
        return True

    def status_item(self) -> StatusItem:
        """Status item of the recording: numbers of recorded and lost scans, waiting data, and current problems."""
        with self._counted:
            return StatusItem(
                name="recording",
                level=Health.ERROR if self._problem else Health.WARN if self._trouble else Health.OK,
                message="; ".join(filter(None, (self._problem, self._trouble))) or f"recording to {self.path}",
                values={
                    "recorded": str(self._recorded),
                    "lost": str(self._lost),
                    "waiting_mb": f"{self._waiting / 1e6:.1f}",
                },
            )

    def post(self, size: int, task: Callable[[], None]) -> bool:
        """Queue a task that holds `size` bytes of memory; return False if the queue is full or the recorder is closed.

        Tasks run one after the other. A full queue still accepts tasks of size 0.
        """

        def run() -> None:
            try:
                task()
            finally:
                with self._counted:
                    self._waiting -= size

        with self._counted:
            if self._is_closed or (size and self._waiting + size > MAXIMUM_WAITING):
                return False
            self._waiting += size
            self._outbox.post(f"recording {next(self._tasks)}", run, lane="recording")
            return True

    def ended(self, step: int, problem: str) -> None:
        """Count a scan as recorded, or as lost if `problem` is not empty."""
        with self._counted:
            self._recorded += not problem
            self._lost += bool(problem)
            self._problem = problem and f"step {step} was only partly recorded: {problem}"
        if problem:
            logger.error("step %d was only partly recorded: %s", step, problem)

    def _open(self) -> RecordingWriter:
        return RecordingWriter(self._files.next(), robot=self._robot, calibration=self._calibration)

    def _add_robot(self) -> None:
        if self._scene is not None:
            self.writer.add_messages(self._scene.unchanging(time.time_ns()))

    def _make_room(self) -> None:
        try:
            self._files.make_room()
            self._report("")
        except RecordingError as error:
            self._report(str(error))

    def _next_file(self) -> None:
        """Continue in a new file if the current file is full; called on the recorder's thread, between two scans."""
        size = self._files.file_size
        if size is None or self.writer.size < size or self.writer.is_scan_open:
            return
        self._make_room()
        full = self.writer
        try:
            # Fails while data rejected by a full disk are still in memory; the current file then stays in use.
            full.flush()
            self.writer = self._open()
        except RecordingError as error:
            self._report(f"no new file: {error}")
            return
        try:
            full.close()
        except RecordingError as error:
            logger.error("%s; `guara convert` makes the file readable", error)
        _guarded("the robot description", self._add_robot)

    def _report(self, trouble: str) -> None:
        """Log a problem of the recording once, and show it in the status until it is solved."""
        if trouble and trouble != self._trouble:
            logger.error("recording: %s", trouble)
        self._trouble = trouble

    def _draw(self, what: str, messages: Callable[[Scene], Iterable[Named]]) -> None:
        """Queue messages for viewers, if the recording has a scene."""
        scene = self._scene
        if scene is not None:
            self._add_later(what, lambda: self.writer.add_messages(messages(scene)))

    def _add_later(self, what: str, add: Callable[[], None]) -> None:
        """Queue data other than frames; an error is logged and does not affect the recording of scans."""
        self.post(0, lambda: _guarded(what, add))


def _guarded(what: str, add: Callable[[], None]) -> None:
    try:
        add()
    except Exception as error:
        logger.error("failed to record %s: %s", what, error)


class ScanRecording:
    """Recording of one scan; a disk error ends the recording, not the scan."""

    def __init__(self, recorder: ScanRecorder, record: ScanRecord, jpeg_quality: int | None) -> None:
        """Queue the start of the recording; called by `ScanRecorder.begin`."""
        self._recorder, self._record, self._quality = recorder, record, jpeg_quality
        # One offset for all stripes: with one each, the stamps of stripes that arrived together would not ascend.
        self._offset = time.time_ns() - round(clock.now() * 1e9)
        # Used by the scan thread only.
        self._last_off: tuple[Image, Image] | None = None
        self._is_full = False
        # Used by the recorder's thread only.
        self._problem = ""
        self._is_open = False
        self._offs: tuple[Image, FrameReference] | None = None
        self._stripes: list[StripeRecord] = []
        self._post(self._begin)

    def add(self, capture: StripeCapture, flash: FlashRecord | None = None, *, instant: float | None = None) -> None:
        """Record one stripe without blocking. A laser-off frame shared by several stripes is written once.

        Args:
            capture: the stripe.
            flash: time of the stripe's flash if its pose comes from a joint stream, else None.
            instant: when the host had received the frames, on `transport.clock` [s]; None = now.
        """
        if self._is_full:
            return
        on, dark = (None if image is None else image.copy() for image in (capture.on, capture.dark))
        off, size = self._shared(capture.off)
        size += sum(image.nbytes for image in (on, dark) if image is not None)
        bare = StripeRecord(
            index=capture.index,
            mirror_angle=capture.mirror_angle,
            on=None,
            off=None,
            stamp=self._offset + round((clock.now() if instant is None else instant) * 1e9),
            is_dark_due=capture.is_dark_due or dark is not None,
            flash=flash,
        )
        if not self._recorder.post(size, lambda: self._guarded(lambda: self._add(bare, on, off, dark))):
            self._is_full = True
            self._post(lambda: self._fail("the disk is too slow: frames were left out"))

    def extend(self, mode: str | None) -> None:
        """Continue with the intermediate stripes of the sweep.

        Args:
            mode: mode of the whole scan, which is recorded as a second scan of this pause and refers to the frames
                already written. None = only some of the intermediate stripes follow; they are not recorded.
        """
        if mode is None:
            self._is_full = True
        else:
            self._post(lambda: self._begin_again(mode))

    def restart(self) -> None:
        """Record another sweep of this pause as a separate scan, without the stripes recorded so far."""
        self._is_full = False
        self._post(self._stripes.clear)
        self._post(lambda: self._begin_again(self._record.mode))

    def finish(self, terrains: tuple[TerrainMessage, ...] = (), stance_end: Stance | None = None) -> None:
        """End the scan and add its grids (none if it failed) without blocking; the recorder's status reports errors."""
        end = None if stance_end is None else stance_to_message(stance_end)
        now = time.time_ns()
        self._recorder.post(0, lambda: self._finish(terrains, end, now))

    def _post(self, action: Callable[[], None]) -> None:
        self._recorder.post(0, lambda: self._guarded(action))

    def _shared(self, image: Image | None) -> tuple[Image | None, int]:
        """Copy of a laser-off frame, one for all its stripes, and the number of bytes newly allocated."""
        if image is None:
            return None, 0
        if self._last_off is not None and self._last_off[0] is image:
            return self._last_off[1], 0
        self._last_off = image, image.copy()
        return self._last_off[1], image.nbytes

    def _begin(self) -> None:
        if self._recorder.writer.is_scan_open:
            # The previous scan was never ended. Keep its stripes in the file, and record this scan.
            self._recorder.writer.end_scan(stamp=time.time_ns())
        self._recorder.writer.begin_scan(self._record)
        self._is_open = True

    def _begin_again(self, mode: str) -> None:
        self._recorder.writer.end_scan(stamp=time.time_ns())
        self._recorder.writer.begin_scan(dataclasses.replace(self._record, mode=mode))
        # Times within a topic must not decrease, so all stripes get the stamp of the last one; frames keep their own.
        for stripe in self._stripes:
            self._write(dataclasses.replace(stripe, stamp=self._stripes[-1].stamp))

    def _add(self, bare: StripeRecord, on: Image | None, off: Image | None, dark: Image | None) -> None:
        def add_frame(pixels: Image, laser_on: bool = False) -> FrameReference:
            return self._recorder.writer.add_frame(self._frame(pixels, bare.stamp), laser_on=laser_on)

        if off is not None and (self._offs is None or self._offs[0] is not off):
            self._offs = off, add_frame(off)
        stripe = dataclasses.replace(
            bare,
            off=None if off is None or self._offs is None else self._offs[1],
            on=None if on is None else add_frame(on, laser_on=True),
            dark=None if dark is None else add_frame(dark),
        )
        self._write(stripe)
        self._stripes.append(stripe)

    def _write(self, stripe: StripeRecord) -> None:
        writer, angle = self._recorder.writer, stripe.mirror_angle
        writer.add_stripe(stripe.index, angle, stripe.on, stripe.off, stamp=stripe.stamp)
        if stripe.is_dark_due:
            writer.add_dark(stripe.index, angle, stripe.dark, stripe.stamp)
        if stripe.flash is not None:
            writer.add_flash(stripe.index, stripe.flash)

    def _guarded(self, action: Callable[[], None]) -> None:
        if not self._problem:
            try:
                action()
            except Exception as error:
                self._fail(str(error))

    def _fail(self, problem: str) -> None:
        self._problem = self._problem or problem

    def _frame(self, pixels: Image, stamp: int) -> FrameRecord:
        if self._quality is None:
            return FrameRecord(pixels=pixels, stamp=stamp)
        # Use 4:4:4: a red stripe is mostly in the chroma channels, whose resolution 4:2:0 would halve.
        options = (cv2.IMWRITE_JPEG_QUALITY, self._quality, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, JPEG_444)
        return FrameRecord(data=cv2.imencode(".jpg", pixels, options)[1].tobytes(), format="jpeg", stamp=stamp)

    def _finish(self, terrains: tuple[TerrainMessage, ...], end: StanceMessage | None, stamp: int) -> None:
        try:
            if self._is_open:
                # Also after an error, so that no scan is open when the next one begins.
                self._is_open = False
                self._recorder.writer.end_scan(stance_end=end, stamp=stamp)
            self._recorder.write_terrains(terrains)
        except Exception as error:
            self._fail(str(error))
        self._recorder.ended(self._record.step, self._problem)
