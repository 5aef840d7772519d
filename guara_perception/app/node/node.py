"""The perception node: scans at every stance pause, and when asked to, on a thread of its own."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from types import TracebackType
from typing import TYPE_CHECKING, Self

from guara_perception.app.node.node_status import NodeStatus
from guara_perception.app.node.pause import Pause, stance_of
from guara_perception.app.node.pause_scanner import PauseScanner
from guara_perception.app.node.rangefinder import Rangefinder
from guara_perception.app.node.recorder import ScanRecorder
from guara_perception.app.node.sweep import SWEEPS
from guara_perception.calibration.calibration import Calibration
from guara_perception.exceptions import InvalidInput, PerceptionError
from guara_perception.progress import Progress
from guara_perception.settings import MODES
from guara_perception.terrain.grid import TerrainGrid
from kinematics import KinematicsError, RobotModel, Stance
from transport import PausePhase, ScanFailed, ScanRequest, StancePause, TerrainMessage, TransportError
from transport.server import PerceptionServer

if TYPE_CHECKING:
    from transport.scan_server import ScanJob

logger = logging.getLogger(__name__)

# How long `close` waits for a scan to notice that it should end.
STOP_TIMEOUT_S = 5.0
EXPECTED = (PerceptionError, KinematicsError, TransportError)


class PerceptionNode:
    """Follows the gait and serves requests.

    Example:
        with rangefinder, PerceptionNode(robot, calibration, rangefinder, server) as node:
            receiver = StanceReceiver(
                session, robot=server.robot, on_pause=node.on_pause, on_refused=node.on_refused
            )
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
        """Wire it up; the `with` block begins.

        Args:
            robot: model.
            calibration: of this rangefinder.
            rangefinder: open devices.
            server: the node's side of the transport.
            mode: of the scans at pauses: "coarse", "standard", or "adaptive" (coarse, and the stripes between where
                there is an obstacle).
            method: stripe extraction.
            recorder: writes every scan, or None.
            status: keeps what the status says, or None for one of its own.

        Raises:
            InvalidInput: unknown mode.
        """
        if mode not in SWEEPS:
            raise InvalidInput(f"mode is {mode!r}, allowed: {', '.join(SWEEPS)}")
        self.status = status or NodeStatus(calibration)
        self._mode, self._server = mode, server
        self._scanner = PauseScanner(
            robot, calibration, rangefinder, server, self.status, method=method, recorder=recorder
        )
        self._changed = threading.Condition()
        self._pause: Pause | None = None
        self._to_scan: Pause | None = None
        self._job: tuple[ScanJob, list[TerrainMessage | Exception]] | None = None
        self._done = -1
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
        """Take note that a stance pause begins or ends; returns at once, the scan runs on the node's own thread.

        A stance that cannot be used (an unknown foot) ends the pause that it speaks of: what is not known to stand
        still is not scanned, and a scan under way is not used.
        """
        try:
            stance: Stance | None = stance_of(announcement)
        except KinematicsError as error:
            self.status.problem("stance", f"step {announcement.step}: {error}")
            stance = None
        with self._changed:
            current = self._pause
            if announcement.phase is PausePhase.END or stance is None:
                if current is not None and not current.ended.is_set():
                    if current.step == announcement.step:
                        current.end(stance)
                    elif announcement.phase is PausePhase.BEGIN or announcement.step > current.step:
                        # Another pause: the end of this one was never announced.
                        current.end(None)
                return
            if current is not None:
                if current.step == announcement.step and not current.ended.is_set():
                    return
                if not current.ended.is_set():
                    # Its end was never announced.
                    current.end(None)
            self._pause = self._to_scan = Pause(
                announcement.step, stance, announcement.known_ground, announcement.time_available
            )
            self._changed.notify_all()
        self.status.solved("stance")
        self._server.begin_step(announcement.step)

    def on_refused(self, error: TransportError) -> None:
        """Take note that the gait announced something that cannot be read, a joint that is NaN for instance.

        It may have been the end of the pause, so that it counts as one.
        """
        self.status.problem("stance", f"announcement refused: {error}")
        with self._changed:
            if self._pause is not None and not self._pause.ended.is_set():
                self._pause.end(None)

    @property
    def latest_map(self) -> TerrainGrid | None:
        """The map as it was fused last, None before the first pause."""
        return self._scanner.latest_map

    def wait_for_step(self, step: int, timeout: float) -> bool:
        """Wait until the scan of a pause is done, or given up; False when `timeout` [s] passed before."""
        with self._changed:
            return self._changed.wait_for(lambda: self._done >= step or self._closing.is_set(), timeout)

    def close(self) -> None:
        """End the scan under way, laser off, and the thread; safe to call twice."""
        self._closing.set()
        with self._changed:
            self._changed.notify_all()
        if self._thread.is_alive():
            self._thread.join(STOP_TIMEOUT_S)

    def _standing(self) -> Pause | None:
        pause = self._pause
        return None if pause is None or pause.ended.is_set() else pause

    def _admit(self, request: ScanRequest) -> None:
        if self._standing() is None:
            raise ScanFailed("the robot is not in a stance pause, a scan needs it to stand still", "not_stationary")
        if request.mode not in MODES:
            raise ScanFailed(f"mode is {request.mode!r}, allowed: {', '.join(MODES)}", "bad_request")

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
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._to_scan or self._job or self._closing.is_set())
                if self._closing.is_set():
                    return
                pause, self._to_scan = self._to_scan, None
                job, self._job = (self._job, None) if pause is None else (None, self._job)
            if pause is not None:
                self._scan(pause, self._mode, lambda: False, None)
                with self._changed:
                    self._done = pause.step
                    self._changed.notify_all()
            elif job is not None:
                self._run_job(*job)

    def _run_job(self, job: ScanJob, result: list[TerrainMessage | Exception]) -> None:
        pause = self._standing()
        if pause is None:
            outcome: TerrainMessage | Exception = ScanFailed("the stance pause ended", "not_stationary")
        else:
            outcome = self._scan(pause, job.request.mode, job.cancelled.is_set, job.progress)
        with self._changed:
            result.append(outcome)
            self._changed.notify_all()

    def _scan(
        self, pause: Pause, mode: str, is_cancelled: Callable[[], bool], progress: Progress | None
    ) -> TerrainMessage | Exception:
        """Scan; whatever goes wrong is logged and stands in the status, and the next pause scans again."""

        def should_stop() -> bool:
            return pause.ended.is_set() or self._closing.is_set() or is_cancelled()

        try:
            return self._scanner.scan(pause, mode, should_stop, progress)
        except Exception as error:
            self.status.problem("scan", f"step {pause.step}: {error}")
            if isinstance(error, EXPECTED):
                logger.error("step %d: no scan: %s", pause.step, error)
            else:
                logger.exception("step %d: no scan", pause.step)
            return error
