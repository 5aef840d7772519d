"""The perception node: at every stance pause it scans, maps, publishes and records; requests are served in between."""

from __future__ import annotations

import dataclasses
import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from types import TracebackType
from typing import TYPE_CHECKING, Self

from guara_perception.app.node.walk_map import WalkMap

from guara_perception.app.node.live_scan import LiveScan, live_scan
from guara_perception.app.node.node_status import NodeStatus
from guara_perception.app.node.rangefinder import Rangefinder
from guara_perception.app.node.recorder import ScanRecorder, ScanRecording
from guara_perception.app.publisher import publish_terrain
from guara_perception.app.summary import summary
from guara_perception.calibration.calibration import Calibration
from guara_perception.exceptions import InvalidInput, PerceptionError
from guara_perception.scan_processor import ScanProcessor
from guara_perception.settings import MODES, Settings
from guara_perception.terrain.grid import TerrainGrid
from kinematics import KinematicsError, RobotModel, Stance
from transport import PausePhase, ScanFailed, ScanRequest, StancePause, TerrainMessage, TransportError
from transport.server import PerceptionServer

if TYPE_CHECKING:
    from drivers import StripeCapture
    from transport.scan_server import ScanJob

logger = logging.getLogger(__name__)

# How long `close` waits for a scan to notice that it should end.
STOP_TIMEOUT_S = 5.0


@dataclass
class _Pause:
    """The pause that the gait is in."""

    step: int
    stance: Stance
    ended: threading.Event
    end_stance: Stance | None = None


class PerceptionNode:
    """Scans at stance pauses; everything that takes time runs on one thread of its own.

    Example:
        with rangefinder, PerceptionNode(robot, calibration, rangefinder, server) as node:
            receiver = StanceReceiver(session, robot=server.robot, on_pause=node.on_pause)
    """

    def __init__(
        self,
        robot: RobotModel,
        calibration: Calibration,
        rangefinder: Rangefinder,
        server: PerceptionServer,
        *,
        mode: str = "standard",
        method: str = "precise",
        recorder: ScanRecorder | None = None,
        status: NodeStatus | None = None,
    ) -> None:
        """Wire it up; `start` (or the `with` block) begins.

        Args:
            robot: model.
            calibration: of this rangefinder.
            rangefinder: open devices.
            server: the node's side of the transport.
            mode: of the scans at pauses, "coarse" or "standard".
            method: stripe extraction.
            recorder: writes every scan, or None.
            status: keeps what `status` publishes, or None for one of its own.

        Raises:
            InvalidInput: unknown mode.
        """
        if mode not in MODES:
            raise InvalidInput(f"mode is {mode!r}, allowed: {', '.join(MODES)}")
        self._robot, self._calibration, self._rangefinder = robot, calibration, rangefinder
        self._server, self._mode, self._method, self._recorder = server, mode, method, recorder
        self._settings = Settings.of(robot)
        self._map = WalkMap(robot, calibration)
        self.status = status or NodeStatus()
        self._changed = threading.Condition()
        self._pause: _Pause | None = None
        self._to_scan: _Pause | None = None
        self._job: tuple[ScanJob, list[TerrainMessage | Exception]] | None = None
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="guara-scans", daemon=True)
        server.serve_scans(self._serve, admission=self._admit)

    def __enter__(self) -> Self:
        """Start."""
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close."""
        self.close()

    def on_pause(self, announcement: StancePause) -> None:
        """Take note that a stance pause begins or ends; returns at once, the scan runs on the node's own thread."""
        try:
            stance = Stance(
                announcement.stance.joint_positions,
                announcement.stance.support_feet,
                announcement.stance.gravity_in_base,
            )
        except KinematicsError as error:
            self.status.problem("stance", f"step {announcement.step}: {error}")
            self._end_pause(announcement.step, None)
            return
        if announcement.phase is PausePhase.END:
            self._end_pause(announcement.step, stance)
            return
        with self._changed:
            if self._pause is not None and self._pause.step == announcement.step and not self._pause.ended.is_set():
                return
            if self._pause is not None:
                self._pause.ended.set()
            self._pause = self._to_scan = _Pause(announcement.step, stance, threading.Event())
            self._map.declare(announcement.known_ground)
            self._changed.notify_all()
        self._server.begin_step(announcement.step)

    def close(self) -> None:
        """End the scan under way, laser off, and the thread; safe to call twice."""
        self._closing.set()
        with self._changed:
            self._changed.notify_all()
        if self._thread.is_alive():
            self._thread.join(STOP_TIMEOUT_S)

    def _end_pause(self, step: int, stance: Stance | None) -> None:
        with self._changed:
            pause = self._pause
            if pause is not None and pause.step == step:
                pause.end_stance = stance
                pause.ended.set()

    def _admit(self, request: ScanRequest) -> None:
        if self._standing() is None:
            raise ScanFailed("the robot is not in a stance pause, a scan needs it to stand still", "not_stationary")
        if request.mode not in MODES:
            raise ScanFailed(f"mode is {request.mode!r}, allowed: {', '.join(MODES)}", "bad_request")

    def _standing(self) -> _Pause | None:
        pause = self._pause
        return None if pause is None or pause.ended.is_set() else pause

    def _serve(self, job: ScanJob) -> TerrainMessage:
        result: list[TerrainMessage | Exception] = []
        with self._changed:
            self._job = (job, result)
            self._changed.notify_all()
            self._changed.wait_for(lambda: result or job.cancelled.is_set() or self._closing.is_set())
        if not result:
            raise ScanFailed("the node is closing" if self._closing.is_set() else "the request was given up")
        if isinstance(result[0], Exception):
            raise ScanFailed(str(result[0])) from result[0]
        return result[0]

    def _run(self) -> None:
        while not self._closing.is_set():
            with self._changed:
                self._changed.wait_for(lambda: self._to_scan or self._job or self._closing.is_set())
                pause, self._to_scan = self._to_scan, None
                job, self._job = (self._job, None) if pause is None else (None, self._job)
            if self._closing.is_set():
                return
            if pause is not None:
                self._scan_safely(pause, self._mode, lambda: False, None)
            elif job is not None:
                self._run_job(*job)

    def _run_job(self, job: ScanJob, result: list[TerrainMessage | Exception]) -> None:
        pause = self._standing()
        if pause is None:
            outcome: TerrainMessage | Exception = ScanFailed("the stance pause ended", "not_stationary")
        else:
            outcome = self._scan_safely(pause, job.request.mode, job.cancelled.is_set, job.progress)
        with self._changed:
            result.append(outcome)
            self._changed.notify_all()

    def _scan_safely(
        self,
        pause: _Pause,
        mode: str,
        is_cancelled: Callable[[], bool],
        report: Callable[[int, int], None] | None,
    ) -> TerrainMessage | Exception:
        """Scan; whatever goes wrong is logged and told in the status, and the next pause scans again."""
        try:
            return self._scan(pause, mode, is_cancelled, report)
        except Exception as error:
            logger.error("step %d: no scan: %s", pause.step, error)
            self.status.problem("scan", f"step {pause.step}: {error}")
            if not isinstance(error, PerceptionError | KinematicsError | ScanFailed):
                logger.exception("unexpected")
            return error

    def _scan(
        self,
        pause: _Pause,
        mode: str,
        is_cancelled: Callable[[], bool],
        report: Callable[[int, int], None] | None,
    ) -> TerrainMessage:
        wanted = set(self._settings.pattern(mode))
        pattern = [(s.index, s.mirror_angle) for s in self._calibration.stripes if s.index in wanted]
        processor = ScanProcessor(
            self._calibration,
            self._robot,
            pause.stance,
            mode,
            method=self._method,
            stamp=time.time_ns(),
            step=pause.step,
        )
        recording = None if self._recorder is None else self._recorder.begin(pause.step, mode, pause.stance)
        done = 0

        def on_stripe(capture: StripeCapture) -> None:
            nonlocal done
            done += 1
            if report is not None:
                report(done, len(pattern))
            if recording is not None:
                recording.add(capture)

        def should_stop() -> bool:
            return pause.ended.is_set() or self._closing.is_set() or is_cancelled()

        try:
            scan = live_scan(self._rangefinder, processor, pattern, should_stop=should_stop, on_stripe=on_stripe)
            self._check_still(pause)
            terrain = with_problems(processor.finish(), scan)
        except BaseException:
            if recording is not None:
                recording.abandon()
            raise
        message = publish_terrain(self._server, terrain, scan_start=scan.start, scan_end=scan.end)
        latency = time.monotonic() - scan.last_frame
        fused = self._map.update(pause.step, pause.stance, terrain)
        fused_message = publish_terrain(self._server, fused, scan_start=scan.start, scan_end=scan.end)
        self.status.scanned(terrain, scan, latency)
        logger.info("%s", summary(terrain))
        if recording is not None:
            self._finish_recording(recording, (message, fused_message), pause.end_stance)
        return message

    def _check_still(self, pause: _Pause) -> None:
        from kinematics import check_camera_still

        if pause.end_stance is not None:
            check_camera_still(
                self._robot,
                pause.stance,
                pause.end_stance,
                transform_camera_to_base=self._calibration.transform_camera_to_base,
            )

    def _finish_recording(
        self, recording: ScanRecording, terrains: tuple[TerrainMessage, ...], stance_end: Stance | None
    ) -> None:
        """A full disk must not cost the scan: it was published, the status says what failed."""
        try:
            recording.finish(terrains, stance_end)
            self.status.solved("recording")
        except (OSError, TransportError) as error:
            logger.error("recording failed: %s", error)
            self.status.problem("recording", str(error))


def with_problems(terrain: TerrainGrid, scan: LiveScan) -> TerrainGrid:
    """The grid, its health telling what the devices had to say."""
    if not scan.problems and not scan.stopped_early:
        return terrain
    health = terrain.metadata["health"]
    reasons = [*health["reasons"], *scan.problems]
    if scan.stopped_early:
        reasons.append("the pause ended before the scan")
    level = "failed" if scan.failed else "degraded"
    return dataclasses.replace(terrain, metadata={**terrain.metadata, "health": {"level": level, "reasons": reasons}})
