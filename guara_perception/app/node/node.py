"""Perception node: scans at every stance pause, and on request, on its own thread."""

from __future__ import annotations

import logging
import math
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Self

from guara_perception.app.node.announcements import Walks, declared_ground, stance_of
from guara_perception.app.node.heap import Heap
from guara_perception.app.node.node_status import pause_item
from guara_perception.app.node.pause import Pause
from guara_perception.app.node.pause_scanner import PauseScanner
from guara_perception.app.node.pause_stream import PauseStream
from guara_perception.app.node.stream_watch import StreamWatch
from guara_perception.app.node.sweep import SWEEPS
from guara_perception.exceptions import InvalidInput, PerceptionError
from guara_perception.progress import Progress
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.map.known_ground import KnownGround
from kinematics import KinematicsError, Stance, Stillness
from transport import (
    Health,
    PausePhase,
    ScanFailed,
    ScanRequest,
    StancePause,
    StanceStream,
    StatusItem,
    TerrainMessage,
    TransportError,
    UnknownPhase,
    clock,
)
from transport.supervision import Failure, follow, forget, supervised

if TYPE_CHECKING:
    from transport.queries.scan_server import ScanJob

logger = logging.getLogger(__name__)

# Longest wait for the scan thread to end when the node stops [s].
STOP_TIMEOUT_S = 5.0
# Extra wait after the deadline of a pause, so that the pause has expired when the thread wakes [s].
EXPIRY_SLACK_S = 0.01
SCAN_THREAD = "guara-scans"
# [s] A scan thread that works this long without reaching the next stripe counts as hung. Drivers take up to 15 s to
# give up on a disconnected camera.
HANG_TIME_S = 30.0
# Epoch of a pause that cannot be scanned and has a lower step than the last pause, if the gait gives no epochs: another
# walk has begun.
UNKNOWN_WALK = "unknown"
# Longest uninterrupted wait of the scan thread during a pause [s].
LONGEST_WAIT_S = 3600.0
EXPECTED = (PerceptionError, KinematicsError, TransportError)


class PerceptionNode:
    """Node that follows the gait, scans at its stance pauses and serves scan requests.

    Example:
        with rangefinder, PerceptionNode(PauseScanner(robot, calibration, rangefinder, server)) as node:
            receiver = StanceReceiver(
                session, robot=server.robot, on_pause=node.on_pause, on_refused=node.on_refused
            )
    """

    def __init__(self, scanner: PauseScanner, mode: str = "standard") -> None:
        """Create the node; the `with` block starts it.

        Args:
            scanner: scanner with open devices.
            mode: mode of the scans at pauses: "coarse", "standard", or "adaptive" (coarse, then the stripes in between
                if this pause or a recent one has obstacles).

        Raises:
            InvalidInput: unknown mode.
        """
        if mode not in SWEEPS:
            raise InvalidInput(f"mode is {mode!r}; allowed: {', '.join(SWEEPS)}")
        self._scanner, self._mode, self.status = scanner, mode, scanner.status
        self._robot, self._recorder, self._server = scanner.robot, scanner.recorder, scanner.server
        self._camera, server = scanner.calibration.transform_camera_to_base, scanner.server
        self.status.on_change = lambda: server.status_changed()
        if self._recorder is not None:
            server.follow_status(self._recorder.add_status)
        self._changed = threading.Condition()
        self._gait_clock = server.gait_clock(self._wake)
        self._pause: Pause | None = None
        self._walks = Walks(server.robot, server.run)
        self._has_news = False
        self._to_scan: Pause | None = None
        self._job: tuple[ScanJob, list[TerrainMessage | Exception]] | None = None
        self._done = ("", -1)
        self._is_asked = False
        self._closing = threading.Event()
        self._thread = supervised(SCAN_THREAD, self._run)
        # Time of the scan thread's last progress; infinite while it waits for work.
        self._progress_at = math.inf
        self.status.follow(self._thread_item)
        self.status.follow(self._pause_item)
        self._stream = StreamWatch(self._robot, server.robot)
        self._has_stream = False
        server.serve_scans(self._serve, admission=self._admit)

    def __enter__(self) -> Self:
        """Start the scan thread."""
        follow(self._end_unknown)
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        """Stop the scan under way, which turns the laser off, and end the thread."""
        forget(self._end_unknown)
        self._closing.set()
        with self._changed:
            self._changed.notify_all()
        if self._thread.is_alive():
            self._thread.join(STOP_TIMEOUT_S)
        self._gait_clock.close()

    def on_pause(self, announcement: StancePause) -> None:
        """Handle an announcement of a stance pause. Returns immediately: the scan runs on the node's own thread.

        An unusable stance (for instance one with an unknown foot) ends its pause, since the robot is not known to stand
        still: no scan is started, and a scan that is not confirmed yet is discarded. An announcement that does not fit
        the walk is ignored and reported in the status.
        """
        now = clock.now()
        if self._recorder is not None:
            self._recorder.add_stance(announcement)
        refusal = self._walks.refusal(announcement, self._pause)
        if refusal:
            self.status.problem("stance", f"step {announcement.step}: {refusal}; the announcement is ignored")
            return
        try:
            stance: Stance | None = stance_of(announcement, self._robot)
        except KinematicsError as error:
            self.status.problem("stance", f"step {announcement.step}: {error}")
            stance = None
        with self._changed:
            begun = self._follow(announcement, stance, now)
            self._wake()
        if begun is not None:
            self.status.solved("stance")
            self._gait_clock.wake()
            self._server.begin_step(begun.step, begun.epoch)
            return
        last = self._pause
        is_unusable = announcement.phase is PausePhase.BEGIN and stance is None
        if is_unusable or last is None or self._is_later(announcement, last):
            # A pause that cannot be scanned, or whose BEGIN was missed, also makes the earlier grids stale.
            is_recount = not announcement.epoch and last is not None and announcement.step < last.step
            self._server.begin_step(announcement.step, UNKNOWN_WALK if is_recount else announcement.epoch)
        if last is None or last.ended.is_set():
            self._server.end_step()

    def on_stream(self, batch: StanceStream) -> None:
        """Handle a batch of joint samples without blocking: add it to the stream, and record it if it is usable."""
        self._report_stream()
        if self._stream.add(batch) and self._recorder is not None:
            self._recorder.add_stream(batch)

    def on_stream_refused(self, error: TransportError) -> None:
        """Handle a batch of joint samples that cannot be decoded."""
        self._report_stream()
        self._stream.refuse(error)

    def _report_stream(self) -> None:
        """Add the status item of the joint stream when its first batch arrives."""
        if not self._has_stream:
            self._has_stream = True
            self.status.follow(self._stream.item)

    def _follow(self, announcement: StancePause, stance: Stance | None, now: float) -> Pause | None:
        """Apply an announcement to its pause; return the pause that it begins, if any."""
        current, last = self._standing(), self._pause
        phase, step, stamp = announcement.phase, announcement.step, announcement.stamp
        is_same = last is not None and (last.step, last.given_epoch) == (step, announcement.epoch)
        if current is not None and is_same:
            if phase is PausePhase.HOLD:
                current.hold(stance, now, stamp, announcement.time_available)
            elif phase is PausePhase.END or stance is None:
                current.end(stance, now, stamp)
            elif not announcement.epoch and stamp > current.newest_stamp:
                # A gait without epochs repeats a step number after a restart, and the robot may have been carried.
                current.end(None)
            elif current.begin_again(stance, now, stamp):
                return None
        elif last is not None and is_same and phase is not PausePhase.BEGIN:
            last.add_late(stance, now, stamp)
        elif current is not None and (phase is PausePhase.BEGIN or self._is_later(announcement, current)):
            # The announcement belongs to a later pause: the END of the current pause is missing.
            current.end(None)
        if phase is not PausePhase.BEGIN or stance is None:
            return None
        parts, epoch, camera = (self._robot, stance, stamp, self._gait_clock), announcement.epoch, self._camera
        stream = self._stream.begin(lambda: PauseStream(*parts, epoch=epoch, transform_camera_to_base=camera), epoch)
        self._pause = self._to_scan = Pause(
            step=step,
            epoch=self._walks.epoch_of(announcement, self._pause),
            given_epoch=epoch,
            stance=stance,
            stillness=Stillness(self._robot, stance, 0.0, transform_camera_to_base=camera),
            earliest=self._gait_clock.earliest,
            limits=self._robot.pause_limits,
            begun=now,
            known_ground=self._ground_of(announcement),
            standing_pauses=dict(zip(stance.support_feet, announcement.standing_pauses, strict=False)),
            time_available=announcement.time_available,
            stamp=stamp,
            stream=stream,
        )
        return self._pause

    def _ground_of(self, announcement: StancePause) -> tuple[KnownGround, ...]:
        try:
            ground = declared_ground(announcement, self._scanner.settings)
        except InvalidInput as error:
            self.status.problem("known_ground", f"step {announcement.step}: {error}")
            return ()
        self.status.solved("known_ground")
        return ground

    def _is_later(self, announcement: StancePause, current: Pause) -> bool:
        return announcement.epoch != current.given_epoch or announcement.step > current.step

    def _wake(self) -> None:
        """Make the scan thread check confirmations again, after an announcement or a better clock estimate."""
        with self._changed:
            self._has_news = True
            self._changed.notify_all()

    def on_refused(self, error: TransportError) -> None:
        """Handle an announcement that cannot be used, such as one in which a joint is NaN.

        The announcement may have been the END, so the pause ends. An announcement with an unknown phase, from a later
        version, is only reported in the status.
        """
        self.status.problem("stance", f"announcement refused: {error}")
        if isinstance(error, UnknownPhase):
            return
        self._end_unknown()

    def _end_unknown(self, failure: Failure | None = None) -> None:
        """End the pause and its scan, since the robot is no longer known to stand still.

        Args:
            failure: failure of a thread of this process that caused the call, or None; unused.
        """
        with self._changed:
            current = self._standing()
            if current is not None:
                current.end(None)
                self._server.end_step()
            self._wake()

    def is_well(self) -> bool:
        """False if the scan thread of a started node has ended or is hung."""
        return self._thread_item().level is Health.OK

    def _is_hung(self) -> bool:
        return clock.now() - self._progress_at > HANG_TIME_S

    def _thread_item(self) -> StatusItem:
        """Status item of the scan thread: an error if the thread has ended or makes no progress."""
        name = f"thread {SCAN_THREAD}"
        is_due = self._thread.ident is not None and not self._closing.is_set()
        if not is_due or (self._thread.is_alive() and not self._is_hung()):
            return StatusItem(name=name, level=Health.OK, message="running")
        fault = f"no progress for more than {HANG_TIME_S:g} s" if self._thread.is_alive() else "not running"
        return StatusItem(name=name, level=Health.ERROR, message=f"{fault}: no pause is scanned. Restart the node")

    @property
    def latest_map(self) -> TerrainGrid | None:
        """Newest fused map; None before the first scan."""
        return self._scanner.map.latest

    def wait_for_step(self, step: int, timeout: float, epoch: str | None = None) -> bool:
        """Wait until the scan of a pause has ended or the node is closing; return False after `timeout` [s].

        Args:
            step: number of the pause; the scan of a later pause also ends the wait.
            timeout: longest wait [s].
            epoch: walk of the pause; None = the walk of the newest scan.
        """

        def is_done() -> bool:
            walk, done = self._done
            return self._closing.is_set() or (done >= step and epoch in (None, walk))

        with self._changed:
            return self._changed.wait_for(is_done, timeout)

    def wait_for_requests(self, timeout: float) -> bool:
        """Wait until no requested scan is under way or the node is closing; return False after `timeout` [s]."""
        with self._changed:
            return self._changed.wait_for(lambda: not self._is_asked or self._closing.is_set(), timeout)

    def _pause_item(self) -> StatusItem:
        pause = self._pause
        is_scanned = pause is not None and self._done == (pause.epoch, pause.step)
        return pause_item(pause, is_scanned, self._gait_clock.at(clock.now()))

    def _standing(self) -> Pause | None:
        """Current pause; None if no pause has begun or the last one has ended."""
        pause = self._pause
        if pause is None:
            return None
        pause.expire(clock.now())
        return None if pause.ended.is_set() else pause

    def _admit(self, request: ScanRequest) -> None:
        pause = self._standing()
        if pause is None or not pause.time_left(clock.now()):
            raise ScanFailed("the robot is not in a stance pause; a scan requires it to stand still", "not_stationary")

    def _serve(self, job: ScanJob) -> TerrainMessage:
        result: list[TerrainMessage | Exception] = []
        with self._changed:
            self._job, self._is_asked = (job, result), True
            self._changed.notify_all()
            self._changed.wait_for(lambda: result or job.cancelled.is_set() or self._closing.is_set())
            self._is_asked = False
            self._changed.notify_all()
        if not result:
            raise ScanFailed("the node is closing" if self._closing.is_set() else "the request was cancelled")
        if isinstance(result[0], Exception):
            raise ScanFailed(str(result[0])) from result[0]
        return result[0]

    def _run(self) -> None:
        heap = Heap()
        self._note_progress()
        self._scanner.lost_steps()
        while True:
            with self._changed:
                self._progress_at = math.inf
                self._changed.wait_for(self._has_work, self._until_expiry())
                self._note_progress()
                if self._closing.is_set():
                    return
                if self._pause is not None and self._standing() is None:
                    self._server.end_step()
                self._has_news = False
                pause, self._to_scan = self._to_scan, None
                job, self._job = (self._job, None) if pause is None else (None, self._job)
            self._settle()
            if pause is not None:
                self._scan(pause, self._mode, lambda: False, None)
                with self._changed:
                    self._done = (pause.epoch, pause.step)
                    self._changed.notify_all()
                heap.trim()
            elif job is not None:
                self._run_job(*job)

    def _note_progress(self) -> None:
        self._progress_at = clock.now()

    def _has_work(self) -> bool:
        return bool(self._to_scan or self._job or self._has_news or self._closing.is_set())

    def _until_expiry(self) -> float | None:
        """Time until the pause expires [s]; None if no pause is under way."""
        pause = self._pause
        if pause is None or pause.ended.is_set():
            return None
        # A condition cannot wait arbitrarily long, and robot.toml does not bound the time of a pause.
        return min(max(pause.deadline - clock.now(), 0.0) + EXPIRY_SLACK_S, LONGEST_WAIT_S)

    def _settle(self) -> None:
        try:
            self._scanner.settle()
        except Exception as error:
            self.status.problem("scan", f"the last grid could not be confirmed or withdrawn: {error}")
            logger.exception("the last grid could not be confirmed or withdrawn")

    def _run_job(self, job: ScanJob, result: list[TerrainMessage | Exception]) -> None:
        pause = self._standing()
        outcome: TerrainMessage | Exception = ScanFailed("the scan thread failed", "internal")
        try:
            if pause is None:
                outcome = ScanFailed("the stance pause ended", "not_stationary")
            else:
                outcome = self._scan(pause, job.request.mode, job.cancelled.is_set, job.progress)
        finally:
            with self._changed:
                result.append(outcome)
                self._changed.notify_all()

    def _scan(
        self, pause: Pause, mode: str, is_cancelled: Callable[[], bool], progress: Progress | None
    ) -> TerrainMessage | Exception:
        """Scan at a pause; return the message, or the error after reporting it in the log and the status."""

        def should_stop() -> bool:
            now = clock.now()
            pause.expire(now)
            is_over = pause.ended.is_set() or not pause.time_left(now)
            return is_over or self._closing.is_set() or is_cancelled() or self._is_hung()

        def advance(done: int, total: int) -> None:
            self._note_progress()
            if progress is not None:
                progress(done, total)

        try:
            return self._scanner.scan(pause, mode, should_stop, advance)
        except Exception as error:
            self.status.problem("scan", f"step {pause.step}: {error}")
            if isinstance(error, EXPECTED):
                logger.error("step %d: no scan: %s", pause.step, error)
            else:
                logger.exception("step %d: no scan", pause.step)
            self._settle()
            return error
