"""Scanner of a stance pause: scan, publish the grid, check the mirror, update and publish the map, record."""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Callable

from drivers import DriverError
from guara_perception.app.node.consistency import JointWatch
from guara_perception.app.node.journal import Journal
from guara_perception.app.node.node_status import NodeStatus
from guara_perception.app.node.pause import Pause
from guara_perception.app.node.published_scans import PublishedScans
from guara_perception.app.node.rangefinder import Rangefinder, firing_order
from guara_perception.app.node.recorder import ScanRecorder
from guara_perception.app.node.sweep import ADAPTIVE, Sweeper, SweepJob
from guara_perception.app.node.walk_map import WalkMap
from guara_perception.app.scene.live import LiveView, SceneMirror
from guara_perception.app.summary import summary
from guara_perception.calibration.calibration import Calibration
from guara_perception.exceptions import MirrorSlipped
from guara_perception.progress import Progress
from guara_perception.scanning.scan_processor import ScanProcessor
from guara_perception.scanning.stripe_finder import METHODS, check_method
from guara_perception.settings import Settings
from guara_perception.terrain.scan.policy import ScanPolicy
from kinematics import RobotModel
from transport import TerrainMessage, clock
from transport.server import PerceptionServer

logger = logging.getLogger(__name__)
# Number of recent scans whose longest delay from the last frame to the published grid is the estimate for the next
# scan.
TAILS = 5


class PauseScanner:
    """Scanner of successive pauses; not thread-safe.

    Attributes:
        robot, calibration, server, status, recorder: as given.
        settings: settings of the robot.
        map: fused map of the walk.
    """

    def __init__(
        self,
        robot: RobotModel,
        calibration: Calibration,
        rangefinder: Rangefinder,
        server: PerceptionServer,
        *,
        method: str = "precise",
        threshold: float | None = None,
        recorder: ScanRecorder | None = None,
        status: NodeStatus | None = None,
        mirror: SceneMirror | None = None,
        journal: Journal | None = None,
    ) -> None:
        """Create the parts of the scanner.

        Args:
            robot: model of the robot.
            calibration: calibration of this rangefinder.
            rangefinder: open devices.
            server: the node's side of the transport.
            method: stripe extraction method.
            threshold: binarisation threshold of the paper's methods; None = chosen for each frame.
            recorder: recorder of every scan; None = no recording.
            status: collector of the status items; None = a new one.
            mirror: publisher of each pause for ROS 2 tools, or None.
            journal: store of the walk at each confirmed pause, read when the node is restarted; or None.

        Raises:
            InvalidInput: unknown method, an invalid threshold, or a threshold for a method that has none.
        """
        check_method(method, threshold)
        self.robot, self.calibration, self._rangefinder, self.server = robot, calibration, rangefinder, server
        self.status = status = status or NodeStatus(calibration)
        self.recorder, self._mirror, self._method, self._threshold = recorder, mirror, method, threshold
        if recorder is not None:
            status.follow(recorder.status_item)
        self.settings = Settings.of(robot)
        self._view = LiveView(server.views, centre=self.settings.stripes // 2)
        self.map = WalkMap(robot, calibration, journal)
        if journal is not None:
            status.follow(journal.item)
        self._joints = JointWatch(robot, status)
        self._sweeper = Sweeper(calibration, rangefinder, self.settings, ScanPolicy(robot))
        self._published = PublishedScans(
            server, status, self.map, recorder, lambda pause: self._processor(pause, "standard").finish(), journal
        )
        self._tails: deque[float] = deque(maxlen=TAILS)

    def scan(
        self, pause: Pause, mode: str, should_stop: Callable[[], bool], progress: Progress | None = None
    ) -> TerrainMessage:
        """Scan at a pause and publish the grid and the map, both provisional until joint readings confirm the scan.

        If a device fails during the sweep, the scan ends early, and the health of the grid states the failure.

        Args:
            pause: current pause of the gait.
            mode: one of SWEEPS.
            should_stop: function that returns True to end the scan early; stripes not yet fired stay unscanned.
            progress: called with (stripes done, total number of stripes), or None.

        Returns:
            Message of the scan's grid, which has been handed over for sending.

        Raises:
            CameraMoved: the robot moved, or may have moved, during the scan; at most a coarse grid was published, which
                `settle` confirms, cuts or withdraws.
            CalibrationMismatch: the calibration belongs to another robot, or has no stripe of this mode.
            MirrorSlipped: the mirror lost steps; the grid was published, then withdrawn, and is not in the map.
            kinematics.KinematicsError: the stance does not fit the robot.
        """
        self._published.begin(pause)
        self._begin_stream(pause)
        self._published.doubts = self._joints.doubts(pause)
        recording = None
        if self._mirror is not None:
            self._mirror.begin(pause.stance, time.time_ns())
        if self.recorder is not None:
            first = "coarse" if mode == ADAPTIVE else mode
            recording = self.recorder.begin(pause.step, first, pause.stance)
        published, messages = self._published, list[TerrainMessage]()
        job = SweepJob(
            processor=lambda of_mode: self._processor(pause, of_mode),
            should_stop=should_stop,
            publish=lambda coarse: messages.append(published.publish(pause, coarse, will_be_refined=True)),
            ends_at=lambda: pause.planned_end if pause.time_available else None,
            tail=max(self._tails, default=0.0),
            progress=progress,
            recording=recording,
            on_stripe=self._view.add,
            stream=lambda: pause.stream,
            placed=lambda processor, scan: self._await_joints(pause, processor, scan.last_frame),
        )
        self._view.begin()
        try:
            swept = published.usable(pause, self._sweeper.sweep(mode, job))
            messages.append(published.publish(pause, swept))
        except BaseException:
            if published.newest is not None:
                published.newest.will_be_refined = False
            if recording is not None:
                recording.finish()
            raise
        self._tails.append(clock.now() - swept.scan.last_frame)
        message, scan, processor = messages[-1], swept.scan, swept.processor
        assert published.newest is not None
        terrain = published.newest.terrain
        if self.recorder is not None and recording is not None:
            self.recorder.add_points(processor.points, scan.end)
        if self._mirror is not None:
            self._mirror.points(processor.points, scan.end)
        self._view.send(processor.points, scan.end)
        self.status.scanned(terrain, scan, self._tails[-1])
        if logger.isEnabledFor(logging.INFO):
            logger.info("%s", summary(terrain))
        self.status.drift(processor.drift())
        self.status.light(processor.light_margins)
        try:
            self._check_steps()
            messages.append(published.publish_map())
        except MirrorSlipped as error:
            messages.append(published.take_back(pause, str(error)))
            raise
        finally:
            if recording is not None:
                recording.finish(tuple(messages), pause.end_stance)
        if swept.is_cut:
            published.record_cut(pause, [])
        published.settle()
        return message

    def settle(self) -> None:
        """Confirm, cut or withdraw the grids of the newest pause as the gait's latest announcements require."""
        self._published.settle()

    def _begin_stream(self, pause: Pause) -> None:
        """Check that the joint stream can locate the stripes; otherwise ignore the stream and report the reason."""
        why = ""
        if pause.stream is not None:
            if METHODS[self._method] is not None:
                why = f"method {self._method!r} uses one pose for all stripes"
            else:
                flash = self._rangefinder.flash(0.0)
                why = pause.stream.doubt(None if flash is None else (clock.now(), flash[1]))
            if why:
                pause.leave_stream()
        self.status.note("stream_use", f"the joint stream is not used: {why}" if why else "")

    def _await_joints(self, pause: Pause, processor: ScanProcessor, last_frame: float) -> None:
        """Wait for the joint samples that give the pose of the body at each stripe.

        If the samples are unusable, report the fault in the status and require that the body stood still.
        """
        stream = pause.stream
        if stream is None:
            return
        stream.wait(lambda: pause.still_until >= last_frame and not processor.track_fault)
        if fault := processor.track_fault:
            processor.leave_track()
            pause.leave_stream()
            self.status.note("stream_use", fault)

    def _processor(self, pause: Pause, mode: str) -> ScanProcessor:
        return ScanProcessor(
            self.calibration,
            self.robot,
            pause.stance,
            mode,
            method=self._method,
            threshold=self._threshold,
            stamp=time.time_ns(),
            step=pause.step,
            track=None if pause.stream is None else pause.stream.track,
            gravity=self.map.gravity(pause.step, pause.stance, epoch=pause.epoch),
        )

    def _check_steps(self) -> None:
        """Reject a scan in which the mirror lost motor steps, so that stripes were not at their commanded angles.

        The check homes the mirror, which takes a tenth of a second. The grid is therefore published first and
        withdrawn if steps were lost; the scan is fused into the map only after the check.

        Raises:
            MirrorSlipped: steps were lost.
        """
        lost = self.lost_steps()
        if lost:
            raise MirrorSlipped(
                f"the mirror had lost {lost} step{'s' * (lost > 1)} by the end of the scan, so the heights are "
                "wrong: the grid is withdrawn. Check that the mirror turns freely"
            )

    def lost_steps(self) -> int:
        """Home the mirror and move it to the first stripe, so that the next pause need not wait for this motion.

        Returns:
            Motor steps lost since the last homing; 0 if the board fails, which the status reports.
        """
        try:
            lost = self._rangefinder.lost_steps(firing_order(self.calibration, self.settings.pattern("standard")))
        except DriverError as error:
            # A board that is disconnected now does not make the last scan wrong; the next scan reconnects or fails.
            self.status.problem("board", str(error))
            return 0
        self.status.solved("board")
        return lost
