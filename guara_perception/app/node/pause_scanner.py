"""Everything that happens at one pause: sweep, process, publish, check the mirror, fuse, publish the map, record."""

from __future__ import annotations

import dataclasses
import logging
import time
from collections.abc import Callable

from drivers import DriverError
from guara_perception.app.node.live_scan import LiveScan
from guara_perception.app.node.node_status import NodeStatus
from guara_perception.app.node.pause import Pause
from guara_perception.app.node.rangefinder import Rangefinder
from guara_perception.app.node.recorder import ScanRecorder, ScanRecording
from guara_perception.app.node.sweep import ADAPTIVE, Sweeper, SweepJob
from guara_perception.app.node.walk_map import WalkMap
from guara_perception.app.publisher import publish_terrain
from guara_perception.app.summary import summary
from guara_perception.calibration.calibration import Calibration
from guara_perception.calibration.drift import check_drift
from guara_perception.exceptions import MirrorSlipped
from guara_perception.progress import Progress
from guara_perception.scan_processor import ScanProcessor
from guara_perception.settings import Settings
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.scan.policy import ScanPolicy
from kinematics import CameraMoved, RobotModel, Stance, check_camera_still
from transport import TerrainMessage, TransportError
from transport.server import PerceptionServer

logger = logging.getLogger(__name__)

# Neighbouring columns are smoothed over one another: every eighth says as much of the floor, in a fifth of the time.
DRIFT_COLUMNS = 8


class PauseScanner:
    """Scans pauses one after the other; used from one thread."""

    def __init__(
        self,
        robot: RobotModel,
        calibration: Calibration,
        rangefinder: Rangefinder,
        server: PerceptionServer,
        status: NodeStatus,
        *,
        method: str = "precise",
        recorder: ScanRecorder | None = None,
    ) -> None:
        """Wire it up; arguments as of `PerceptionNode`."""
        self._robot, self._calibration, self._rangefinder = robot, calibration, rangefinder
        self._server, self._status, self._method, self._recorder = server, status, method, recorder
        self._settings = Settings.of(robot)
        self._map = WalkMap(robot, calibration)
        self._sweeper = Sweeper(calibration, rangefinder, self._settings, ScanPolicy(robot))

    @property
    def latest_map(self) -> TerrainGrid | None:
        """The map as it was fused last, None before the first pause."""
        return self._map.latest

    def scan(
        self, pause: Pause, mode: str, should_stop: Callable[[], bool], progress: Progress | None = None
    ) -> TerrainMessage:
        """Scan one pause and publish what came of it.

        Args:
            pause: the gait is in.
            mode: one of SWEEPS.
            should_stop: True ends the scan early; what was not fired stays unscanned.
            progress: called with (stripes done, stripes in all).

        Returns:
            The message of the scan's own grid, handed over for sending.

        Raises:
            CameraMoved: the robot moved during the scan, or that is not known; nothing was published.
            MirrorSlipped: the mirror lost steps; the grid was published and withdrawn, and is not in the map.
            KinematicsError: the stance does not fit the robot.
        """
        recording = None
        if self._recorder is not None:
            first = "coarse" if mode == ADAPTIVE else mode
            recording = self._recorder.begin(pause.step, first, pause.stance)
        job = SweepJob(
            processor=lambda of_mode: self._processor(pause, of_mode),
            should_stop=should_stop,
            time_available=pause.time_available,
            progress=progress,
            recording=recording,
        )
        try:
            terrain, scan, processor = self._sweeper.sweep(mode, job)
            self._check_still(pause)
            terrain = with_problems(terrain, scan)
        except BaseException:
            if recording is not None:
                recording.abandon()
            raise
        message = publish_terrain(self._server, terrain, scan_start=scan.start, scan_end=scan.end)
        self._status.scanned(terrain, scan, time.monotonic() - scan.last_frame)
        if logger.isEnabledFor(logging.INFO):
            logger.info("%s", summary(terrain))
        floor = {index: stripe.points[::DRIFT_COLUMNS] for index, stripe in processor.points.items()}
        self._status.drift(check_drift(floor, terrain.metadata["pose_covariance"]))
        try:
            self._check_steps()
        except MirrorSlipped as error:
            withdrawn = publish_terrain(self._server, self._nothing_seen(pause, str(error)))
            self._finish(recording, (message, withdrawn), pause.end_stance)
            raise
        fused = self._map.update(pause.step, pause.stance, terrain, pause.known_ground)
        fused_message = publish_terrain(self._server, fused, scan_start=scan.start, scan_end=scan.end)
        self._finish(recording, (message, fused_message), pause.end_stance)
        return message

    def _processor(self, pause: Pause, mode: str) -> ScanProcessor:
        return ScanProcessor(
            self._calibration,
            self._robot,
            pause.stance,
            mode,
            method=self._method,
            stamp=time.time_ns(),
            step=pause.step,
        )

    def _nothing_seen(self, pause: Pause, reason: str) -> TerrainGrid:
        """The grid that takes another one back: nothing known, and why."""
        empty = self._processor(pause, "standard").finish()
        health = {"level": "failed", "reasons": [reason]}
        return dataclasses.replace(empty, metadata={**empty.metadata, "health": health})

    def _check_still(self, pause: Pause) -> None:
        if not pause.ended.is_set():
            return
        if pause.end_stance is None:
            raise CameraMoved(
                "the pause ended without a stance that can be used: whether the camera stood still during the scan is "
                "not known. The gait must send joints and support feet with END, all finite"
            )
        check_camera_still(
            self._robot,
            pause.stance,
            pause.end_stance,
            transform_camera_to_base=self._calibration.transform_camera_to_base,
        )

    def _check_steps(self) -> None:
        """Count the steps that the mirror lost: only now is it known that every stripe lay where it was commanded.

        Homing takes a tenth of a second, so the grid is published before and withdrawn when it was wrong. Nothing
        goes into the map before.
        """
        try:
            lost = self._rangefinder.lost_steps(self._sweeper.firing_order(self._settings.pattern("standard")))
        except DriverError as error:
            # A board that is gone said nothing false about the scan before; the next scan finds it again or fails.
            self._status.problem("board", str(error))
            return
        self._status.solved("board")
        if lost:
            raise MirrorSlipped(
                f"the mirror had lost {lost} steps by the end of the scan, its heights are wrong: the grid is "
                "withdrawn. Check that the mirror turns freely"
            )

    def _finish(
        self, recording: ScanRecording | None, terrains: tuple[TerrainMessage, ...], stance_end: Stance | None
    ) -> None:
        """A full disk must not cost the scan: it was published, the status says what failed."""
        if recording is None:
            return
        try:
            recording.finish(terrains, stance_end)
            self._status.solved("recording")
        except (OSError, TransportError) as error:
            logger.error("recording failed: %s", error)
            self._status.problem("recording", str(error))


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
