"""Everything that happens at one pause: sweep, process, publish, check the mirror, fuse, publish the map, record."""

from __future__ import annotations

import dataclasses
import logging
import math
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
from guara_perception.app.scene.live_view import LiveView
from guara_perception.app.scene.mirror import SceneMirror
from guara_perception.app.summary import summary
from guara_perception.calibration.calibration import Calibration
from guara_perception.exceptions import MirrorSlipped
from guara_perception.progress import Progress
from guara_perception.scan_drift import scan_drift
from guara_perception.scan_processor import ScanProcessor
from guara_perception.settings import Settings
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.scan.policy import ScanPolicy
from kinematics import CameraMoved, RobotModel, Stance
from transport import TerrainMessage, clock
from transport.server import PerceptionServer

logger = logging.getLogger(__name__)


@dataclasses.dataclass(slots=True)
class Published:
    """The scan whose grid was published last.

    Attributes:
        pause: pause in which it was taken.
        terrain: grid of the scan alone.
        scan: what the devices did in it.
        fused: the map into which it was fused, None until then.
        is_provisional: whether the pause has yet to confirm it.
        was_sent_provisional: whether it was published as provisional.
    """

    pause: Pause
    terrain: TerrainGrid
    scan: LiveScan
    fused: TerrainGrid | None = None
    is_provisional: bool = True
    was_sent_provisional: bool = False


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
        mirror: SceneMirror | None = None,
    ) -> None:
        """Connect its parts; arguments as in `PerceptionNode`."""
        self._mirror = mirror
        self._robot, self._calibration, self._rangefinder = robot, calibration, rangefinder
        self._server, self._status, self._method, self._recorder = server, status, method, recorder
        if recorder is not None:
            status.follow(recorder.status_item)
        self._settings = Settings.of(robot)
        self._view = LiveView(server.views, centre=self._settings.stripes // 2)
        self._map = WalkMap(robot, calibration)
        self._sweeper = Sweeper(calibration, rangefinder, self._settings, ScanPolicy(robot))
        self._published: Published | None = None

    @property
    def latest_map(self) -> TerrainGrid | None:
        """The newest fused map, None before the first pause."""
        return self._map.latest

    def make_ready(self) -> None:
        """Bring the mirror home and to the first stripe, so that the first pause need not wait for it."""
        self._lost_steps()

    def scan(
        self, pause: Pause, mode: str, should_stop: Callable[[], bool], progress: Progress | None = None
    ) -> TerrainMessage:
        """Scan one pause and publish the result, as provisional while the pause has not confirmed it.

        Args:
            pause: pause that the gait is in.
            mode: one of SWEEPS.
            should_stop: True ends the scan early; what was not fired stays unscanned.
            progress: called with (stripes done, stripes in all).

        Returns:
            The message of the scan's own grid, handed over for sending.

        Raises:
            CameraMoved: the robot moved during the scan, or may have moved; nothing was published.
            MirrorSlipped: the mirror lost steps; the grid was published and withdrawn, and is not in the map.
            KinematicsError: the stance does not fit the robot.
        """
        recording = None
        if self._mirror is not None:
            self._mirror.begin(pause.stance, time.time_ns())
        if self._recorder is not None:
            first = "coarse" if mode == ADAPTIVE else mode
            recording = self._recorder.begin(pause.step, first, pause.stance)
        job = SweepJob(
            processor=lambda of_mode: self._processor(pause, of_mode),
            should_stop=should_stop,
            time_available=pause.time_left(time.monotonic()) if pause.time_available else 0.0,
            progress=progress,
            recording=recording,
            on_stripe=self._view.add,
        )
        self._view.begin()
        try:
            swept = self._sweeper.sweep(mode, job)
            scan, processor = swept.scan, swept.processor
            self.settle()
            if pause.broken and pause.still_until < scan.last_frame:
                raise CameraMoved(pause.broken)
            terrain = dataclasses.replace(with_problems(swept.terrain, scan), stamp=scan.end)
        except BaseException:
            if recording is not None:
                recording.abandon()
            raise
        before = self._published
        self._published = published = Published(pause, terrain, scan)
        message = self._send(published, terrain)
        if recording is not None:
            recording.add_points(processor.points, scan.end)
        if self._mirror is not None:
            self._mirror.points(processor.points, scan.end)
        self._view.send(processor.points, scan.end)
        self._status.scanned(terrain, scan, time.monotonic() - scan.last_frame)
        if logger.isEnabledFor(logging.INFO):
            logger.info("%s", summary(terrain))
        self._status.drift(scan_drift(processor))
        try:
            self._check_steps()
        except MirrorSlipped as error:
            nothing = self._nothing_seen(pause, str(error))
            self._published = None
            if before is not None and before.fused is not None:
                # An earlier scan of this pause is in the map: what the pause says of it still counts.
                self._published = Published(pause, nothing, scan, before.fused, was_sent_provisional=True)
            withdrawn = publish_terrain(self._server, nothing)
            self._finish(recording, (message, withdrawn), pause.end_stance)
            raise
        try:
            published.fused = fused = self._map.update(
                pause.step,
                pause.stance,
                swept.wide(terrain),
                pause.known_ground,
                epoch=pause.epoch,
                time=end_of(scan),
            )
        except BaseException:
            self._finish(recording, (message,), pause.end_stance)
            raise
        fused_message = self._send(published, fused)
        self._finish(recording, (message, fused_message), pause.end_stance)
        self.settle()
        return message

    def settle(self) -> None:
        """Confirm or withdraw the newest grid, by what the pause has said since it was published."""
        published = self._published
        if published is None:
            return
        pause = published.pause
        if published.is_provisional and pause.still_until >= published.scan.last_frame:
            published.is_provisional = False
            if published.fused is not None:
                pause.is_fused = True
                self._map.keep()
            if published.was_sent_provisional:
                self._send(published, published.terrain)
                if published.fused is not None:
                    self._send(published, published.fused)
            self._status.confirmed(pause.step)
        if not pause.ended.is_set():
            return
        self._published = None
        if pause.broken and (published.is_provisional or pause.moved):
            self._withdraw(published)

    def _withdraw(self, published: Published) -> None:
        """Publish that nothing of the grid is known any more; if it was never confirmed, undo it in the map too.

        A grid that was confirmed before the robot moved is right, but its frame is no longer where the robot stands.
        """
        pause = published.pause
        reason = f"withdrawn: {pause.broken}"
        self._status.problem("scan", f"step {pause.step}: {reason}")
        logger.error("step %d: %s", pause.step, reason)
        nothing = self._nothing_seen(pause, reason)
        messages = [publish_terrain(self._server, nothing)]
        if published.fused is not None and not pause.is_fused:
            fused = self._map.withdraw(nothing, time=end_of(published.scan))
            messages.append(publish_terrain(self._server, fused, stated=walk_of(pause)))
        if self._recorder is not None:
            self._recorder.add_terrains(pause.step, messages)

    def _send(self, published: Published, terrain: TerrainGrid) -> TerrainMessage:
        """Publish a grid as provisional or confirmed; a provisional one is valid no longer than its pause may last."""
        pause, scan = published.pause, published.scan
        is_provisional = published.is_provisional and pause.still_until < scan.last_frame
        published.was_sent_provisional |= is_provisional
        limit = pause.deadline - scan.last_frame if is_provisional else math.inf
        return publish_terrain(
            self._server,
            terrain,
            scan_start=scan.start,
            scan_end=scan.end,
            scan_end_clock=end_of(scan),
            valid_for=max(limit, 0.0),
            stated=walk_of(pause, is_provisional=is_provisional),
        )

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
        metadata = {**empty.metadata, "health": health, "withdrawn": True, **walk_of(pause)}
        return dataclasses.replace(empty, metadata=metadata)

    def _check_steps(self) -> None:
        """Count the motor steps that the mirror lost: only then is it known that every stripe lay where commanded.

        Homing takes a tenth of a second, so the grid is published before it, and withdrawn when steps were lost. The
        scan is fused into the map only after it.
        """
        lost = self._lost_steps()
        if lost:
            raise MirrorSlipped(
                f"the mirror had lost {lost} steps by the end of the scan, its heights are wrong: the grid is "
                "withdrawn. Check that the mirror turns freely"
            )

    def _lost_steps(self) -> int:
        """What `Rangefinder.lost_steps` gives for the standard pattern; 0 where the board cannot be asked."""
        try:
            lost = self._rangefinder.lost_steps(self._sweeper.firing_order(self._settings.pattern("standard")))
        except DriverError as error:
            # A board that is gone does not make the last scan wrong; the next scan finds it again or fails.
            self._status.problem("board", str(error))
            return 0
        self._status.solved("board")
        return lost

    def _finish(
        self, recording: ScanRecording | None, terrains: tuple[TerrainMessage, ...], stance_end: Stance | None
    ) -> None:
        """Hand the end of a scan to its recording, if there is one; the disk never costs the scan."""
        if recording is not None:
            recording.finish(terrains, stance_end)


def with_problems(terrain: TerrainGrid, scan: LiveScan) -> TerrainGrid:
    """The grid, with the problems of the devices in its health."""
    if not scan.problems and not scan.stopped_early:
        return terrain
    health = terrain.metadata["health"]
    reasons = [*health["reasons"], *scan.problems]
    if scan.stopped_early:
        reasons.append("the pause ended before the scan")
    level = "failed" if scan.failed else "degraded"
    return dataclasses.replace(terrain, metadata={**terrain.metadata, "health": {"level": level, "reasons": reasons}})


def end_of(scan: LiveScan) -> float:
    """The last frame of a scan by the clock that ages are counted by [s]."""
    return clock.now() - (time.monotonic() - scan.last_frame)


def walk_of(pause: Pause, *, is_provisional: bool = False) -> dict[str, object]:
    """Entries of a grid's metadata: its walk, and whether its pause has yet to confirm it."""
    return {"epoch": pause.epoch, "provisional": is_provisional}
