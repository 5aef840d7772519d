"""Everything that happens at one pause: sweep, process, publish, check the mirror, fuse, publish the map, record."""

from __future__ import annotations

import dataclasses
import logging
import math
import time
from collections import deque
from collections.abc import Callable

from drivers import DriverError
from guara_perception.app.messages import terrain_to_message
from guara_perception.app.node.live_scan import LiveScan
from guara_perception.app.node.node_status import NodeStatus
from guara_perception.app.node.pause import Pause
from guara_perception.app.node.rangefinder import Rangefinder
from guara_perception.app.node.recorder import ScanRecorder, ScanRecording
from guara_perception.app.node.sweep import ADAPTIVE, Sweeper, SweepJob, Swept
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
from guara_perception.terrain.layers.record import Health
from guara_perception.terrain.scan.policy import ScanPolicy
from kinematics import CameraMoved, RobotModel, Stance
from transport import TerrainMessage, clock
from transport.keys import gait_clock_key
from transport.server import PerceptionServer

logger = logging.getLogger(__name__)
# Scans whose time from the last frame to the published grid tells how long that of the next one takes: the longest.
TAILS = 5
TOO_LITTLE = (
    "the joints that confirm the scan were read before most of it was taken. The gait must stand until the grid is "
    "there, or say HOLD"
)


@dataclasses.dataclass(slots=True, eq=False)
class Published:
    """A scan whose grid was published.

    Attributes:
        pause: pause in which it was taken.
        swept: the scan and what it was made of.
        terrain: grid of the scan alone.
        fused: the map with it, None while it is not in the map.
        is_confirmed: whether the pause has confirmed it.
        was_sent_provisional: whether it was published as provisional.
        will_be_refined: whether a finer grid of the same pause follows, which is confirmed in its place.
    """

    pause: Pause
    swept: Swept
    terrain: TerrainGrid
    fused: TerrainGrid | None = None
    is_confirmed: bool = False
    was_sent_provisional: bool = False
    will_be_refined: bool = False


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
        # The newest grid of the newest pause, and the scan of that pause that is in the map.
        self._unknown_clock = (
            f"the gait does not tell the clock of its stamps on {gait_clock_key(server.robot)} (no answer, or stamps "
            "that lie ahead of it), so that they confirm no frame: "
            "grids stay provisional and none is in the map. Announce pauses by this version's StancePublisher, or "
            "answer that key (docs/messages.md); with a folder of certificates run `guara security renew`"
        )
        self._newest: Published | None = None
        self._fused: Published | None = None
        self._tails: deque[float] = deque(maxlen=TAILS)

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
            CameraMoved: the robot moved during the scan, or may have moved: nothing was published but, perhaps, a
                coarse grid, which `settle` takes back.
            MirrorSlipped: the mirror lost steps; the grid was published and withdrawn, and is not in the map.
            KinematicsError: the stance does not fit the robot.
        """
        self._begin(pause)
        recording = None
        if self._mirror is not None:
            self._mirror.begin(pause.stance, time.time_ns())
        if self._recorder is not None:
            first = "coarse" if mode == ADAPTIVE else mode
            recording = self._recorder.begin(pause.step, first, pause.stance)
        messages: list[TerrainMessage] = []
        job = SweepJob(
            processor=lambda of_mode: self._processor(pause, of_mode),
            should_stop=should_stop,
            publish=lambda coarse: messages.append(self._publish(pause, coarse, will_be_refined=True)),
            ends_at=lambda: pause.planned_end if pause.time_available else None,
            tail=max(self._tails, default=0.0),
            progress=progress,
            recording=recording,
            on_stripe=self._view.add,
        )
        self._view.begin()
        try:
            swept = self._of_the_pause(pause, self._sweeper.sweep(mode, job))
            messages.append(self._publish(pause, swept))
        except BaseException:
            if self._newest is not None:
                self._newest.will_be_refined = False
            if recording is not None:
                recording.abandon()
            raise
        self._tails.append(clock.now() - swept.scan.last_frame)
        message, published, scan, processor = messages[-1], self._newest, swept.scan, swept.processor
        assert published is not None
        if recording is not None:
            recording.add_points(processor.points, scan.end)
        if self._mirror is not None:
            self._mirror.points(processor.points, scan.end)
        self._view.send(processor.points, scan.end)
        self._status.scanned(published.terrain, scan, self._tails[-1])
        if logger.isEnabledFor(logging.INFO):
            logger.info("%s", summary(published.terrain))
        self._status.drift(scan_drift(processor))
        try:
            self._check_steps()
        except MirrorSlipped as error:
            # An earlier scan of this pause that is in the map stays there.
            self._newest = None
            messages.append(publish_terrain(self._server, self._nothing_seen(pause, str(error))))
            self._finish(recording, messages, pause.end_stance)
            raise
        try:
            if self._fused is None or self._fused.fused is None:
                messages.append(self._fuse(published))
            else:
                messages.append(self._send(self._fused, self._fused.fused))
        finally:
            self._finish(recording, messages, pause.end_stance)
        if swept.is_cut:
            self._record_cut(pause, [])
        self.settle()
        return message

    def settle(self) -> None:
        """Confirm, cut or withdraw what was published of the newest pause, by what the gait has said since."""
        newest, fused = self._newest, self._fused
        either = newest or fused
        if either is None:
            return
        pause = either.pause
        for published in dict.fromkeys(each for each in (fused, newest) if each is not None):
            was_confirmed = published.is_confirmed
            # A motion that comes to light later may have begun before the last frame.
            published.is_confirmed = pause.still_until >= published.swept.scan.last_frame
            if published.is_confirmed and not was_confirmed:
                self._confirm(published)
        if not pause.ended.is_set():
            return
        self._status.note("stillness", pause.stillness.undetectable)
        self._status.note("gait_clock", "" if pause.is_clock_known else self._unknown_clock)
        is_map_wrong = fused is not None and not fused.is_confirmed
        if pause.broken:
            if is_map_wrong or (newest is not None and (pause.moved or not newest.is_confirmed)):
                self._withdraw(pause)
        elif pause.is_clock_known and newest is not None and not newest.is_confirmed:
            self._cut(newest)

    def _begin(self, pause: Pause) -> None:
        """Leave the pause before: what it confirmed stays in the map, all else is out of it."""
        before = self._newest or self._fused
        if before is None or before.pause is pause:
            return
        self.settle()
        if any(each is not None and not each.is_confirmed for each in (self._newest, self._fused)):
            self._withdraw(before.pause)
        if self._fused is not None:
            self._map.keep()
        self._newest = self._fused = None

    def _of_the_pause(self, pause: Pause, swept: Swept) -> Swept:
        """What of a scan may be published: all of it while the pause lasts, then what the gait has confirmed.

        Raises:
            CameraMoved: nothing of it.
        """
        if not pause.ended.is_set() or pause.still_until >= swept.scan.last_frame:
            return swept
        cut = None if pause.broken else swept.until(pause.still_until)
        if cut is None:
            raise CameraMoved(self._why_not(pause))
        return cut

    def _why_not(self, pause: Pause) -> str:
        """Why what was scanned in an ended pause is not used."""
        return pause.broken or (TOO_LITTLE if pause.is_clock_known else self._unknown_clock)

    def _publish(self, pause: Pause, swept: Swept, *, will_be_refined: bool = False) -> TerrainMessage:
        """Publish the grid of a scan; `will_be_refined` where a finer one follows in this pause."""
        terrain = dataclasses.replace(with_problems(swept.terrain, swept.scan), stamp=swept.scan.end)
        self._newest = Published(pause, swept, terrain, will_be_refined=will_be_refined)
        return self._send(self._newest, terrain)

    def _fuse(self, published: Published) -> TerrainMessage:
        """Put a scan into the map, and publish that."""
        pause, swept = published.pause, published.swept
        published.fused = self._map.update(
            pause.step,
            pause.stance,
            swept.wide(published.terrain),
            pause.known_ground,
            epoch=pause.epoch,
            time=swept.scan.last_frame,
        )
        self._fused = published
        return self._send(published, published.fused)

    def _confirm(self, published: Published) -> None:
        if published.was_sent_provisional:
            if published is self._newest:
                self._send(published, published.terrain)
            if published.fused is not None:
                self._send(published, published.fused)
        self._status.confirmed(published.pause.step)

    def _cut(self, newest: Published) -> None:
        """Leave out what was taken later than the joints that confirm the scan, once the pause has ended well."""
        pause = newest.pause
        cut = newest.swept.until(pause.still_until)
        if cut is None:
            self._withdraw(pause)
            return
        messages = [self._publish(pause, cut)]
        if self._fused is not None and not self._fused.is_confirmed:
            self._map.withdraw(self._nothing_seen(pause, TOO_LITTLE), time=cut.scan.last_frame)
            assert self._newest is not None
            messages.append(self._fuse(self._newest))
        self._record_cut(pause, messages)
        self.settle()

    def _record_cut(self, pause: Pause, messages: list[TerrainMessage]) -> None:
        """Record that not all frames of a scan may be used: it is left out of replays, as one that was withdrawn."""
        if self._recorder is not None:
            nothing = self._nothing_seen(pause, TOO_LITTLE)
            mark = terrain_to_message(
                nothing, robot=self._server.robot, sequence=self._server.next_sequence("footprint")
            )
            self._recorder.add_terrains(pause.step, [mark, *messages])

    def _withdraw(self, pause: Pause) -> None:
        """Publish that nothing of the grid is known any more; if it is not confirmed, undo it in the map too.

        A grid that was confirmed before the robot moved is right, but its frame is no longer where the robot stands.
        """
        reason = f"withdrawn: {self._why_not(pause)}"
        self._status.problem("scan", f"step {pause.step}: {reason}")
        logger.error("step %d: %s", pause.step, reason)
        nothing, messages = self._nothing_seen(pause, reason), []
        if self._newest is not None:
            messages.append(publish_terrain(self._server, nothing))
        if self._fused is not None and not self._fused.is_confirmed:
            fused = self._map.withdraw(nothing, time=self._fused.swept.scan.last_frame)
            messages.append(publish_terrain(self._server, fused, stated=walk_of(pause)))
            self._fused = None
        self._newest = None
        if self._recorder is not None:
            self._recorder.add_terrains(pause.step, messages)

    def _send(self, published: Published, terrain: TerrainGrid) -> TerrainMessage:
        """Publish a grid as provisional or confirmed; a provisional one is valid no longer than its pause may last."""
        pause, scan = published.pause, published.swept.scan
        is_provisional = published.will_be_refined or pause.still_until < scan.last_frame
        published.was_sent_provisional |= is_provisional
        limit = pause.deadline - scan.last_frame if is_provisional else math.inf
        return publish_terrain(
            self._server,
            terrain,
            scan_start=scan.start,
            scan_end=scan.end,
            scan_end_clock=scan.last_frame,
            valid_for=max(limit, 0.0),
            stated={
                **walk_of(pause, is_provisional=is_provisional),
                "refinement_follows": published.will_be_refined,
            },
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
        return empty.restated(health=Health("failed", (reason,)), withdrawn=True, **walk_of(pause))

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
        self, recording: ScanRecording | None, terrains: list[TerrainMessage], stance_end: Stance | None
    ) -> None:
        """Hand the end of a scan to its recording, if there is one; the disk never costs the scan."""
        if recording is not None:
            recording.finish(tuple(terrains), stance_end)


def with_problems(terrain: TerrainGrid, scan: LiveScan) -> TerrainGrid:
    """The grid, with the problems of the devices in its health."""
    if not scan.problems and not scan.stopped_early:
        return terrain
    health = terrain.record.health or Health()
    early = ("the pause ended before the scan",) if scan.stopped_early else ()
    level = "failed" if scan.failed else "degraded"
    return terrain.restated(health=Health(level, (*health.reasons, *scan.problems, *early)))


def walk_of(pause: Pause, *, is_provisional: bool = False) -> dict[str, object]:
    """Fields of a grid's record: its walk, and whether its pause has yet to confirm it."""
    return {"epoch": pause.epoch, "provisional": is_provisional}
