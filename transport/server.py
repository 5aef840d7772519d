"""Node side of the transport: publishes grids, status and liveliness, and serves scan requests and queries."""

from __future__ import annotations

import logging
import threading
import time
import uuid
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from transport import clock
from transport.arrays import Percent
from transport.exceptions import MessageError, ReceiveTimeout, check_choice
from transport.grids.grid_publishers import GridPublishers, ViewSender
from transport.keys import (
    DEFAULT_ROBOT,
    alive_key,
    run_key,
)
from transport.links.last_message import Payload
from transport.links.liveliness import AliveToken
from transport.links.outbox import Outbox
from transport.links.ros2 import Ros2Bridge
from transport.links.session import Resource, Session
from transport.messages.codec import encode
from transport.messages.map_messages import RegionsMessage
from transport.messages.status_message import STATUS_NAME, StatusItem
from transport.messages.terrain_message import EXTENTS, Health, TerrainMessage
from transport.messages.typestore import STATUS
from transport.node_name import NAME_TIMEOUT, NameWatch, claim_name
from transport.queries.query import QueryServer
from transport.queries.scan_server import Admission, Handler, ScanJob, ScanServer
from transport.queries.status_reporter import StatusReporter
from transport.stance_link import GaitClock
from transport.supervision import FailureLog

logger = logging.getLogger(__name__)
# Longest time for which the final reply to a scan request waits for the terrain message to be sent [s].
SEND_TIMEOUT = 2.0
# Time during which a jump of the clock stays in the status [s].
REPORTED_FOR = 60.0


class PerceptionServer(Resource):
    """Transport of a robot's perception node. Publishing does not block the calling thread.

    Attributes:
        robot: instance name.
        run: identity of this run of the node, generated at each start and sent in every status. The metadata of grids
            must contain it.
        views: sender of messages for viewers.
        follow_status: adds a receiver of status payloads; see `StatusReporter.follow`.
    """

    def __init__(
        self,
        session: Session,
        *,
        robot: str = DEFAULT_ROBOT,
        collect_status: Callable[[], Sequence[StatusItem]] | None = None,
        ros2_domain: int | None = None,
        name_timeout: float = NAME_TIMEOUT,
    ) -> None:
        """Claim the name, declare keys and liveliness tokens, and start to report the status.

        Args:
            session: open session of the node.
            robot: instance name.
            collect_status: returns further status items; called on several threads, and must return quickly.
            ros2_domain: ROS 2 domain to which occupancy, grid map and status (as `/diagnostics`) are bridged; None = no
                bridge.
            name_timeout: longest wait for another node of this name to stop [s].

        Raises:
            NameTaken: after `name_timeout`, another node still uses the name, or waits for it and takes precedence.
            KeyNameError: the robot's name cannot be part of a key.
            ConfigurationError: the ROS 2 domain is not valid, or the robot's name cannot be part of a ROS 2 topic.
            SessionClosed: the session is closed.
        """
        claim = claim_name(session, robot, timeout=name_timeout)
        self.robot = robot
        self._session = session
        self.run = uuid.uuid4().hex
        self._collect = collect_status
        self._lock = threading.Lock()
        self._newest: dict[str, TerrainMessage] = {}
        # Footprint grid whose occupancy and grid map are currently published.
        self._derived: TerrainMessage | None = None
        self._sequences = dict.fromkeys(EXTENTS, 0)
        self._step: int | None = None
        self._epoch = ""
        self._standing: bool | None = None
        # Last sequence number that was skipped because the gait reused the number of a pause.
        self._given_up = 0
        self._names: NameWatch | None = None
        self._jumps = JumpWatch(robot)
        self._times: list[float] = []
        self._outbox = Outbox()
        self._grids = GridPublishers(session, robot, self._outbox)
        self.views = ViewSender(session, robot=robot)
        self._bridge = None if ros2_domain is None else Ros2Bridge(session, robot=robot, domain=ros2_domain)
        self._draw: Callable[[TerrainMessage], Iterable[tuple[str, Any]]] | None = None
        self._answers, self._stale_answers = 0, 0
        self._queries = QueryServer(session, self._answer, robot=robot)
        self._scans: ScanServer | None = None
        self._gait: GaitClock | None = None
        self._failures = FailureLog(lambda: self._status.changed())
        self._status = StatusReporter(session, self.status_items, robot=robot)
        self.follow_status = self._status.follow
        if self._bridge is not None:
            bridge = self._bridge
            self._status.follow(lambda payload: bridge.put("/diagnostics", STATUS, payload))
        # The tokens come last: clients send queries as soon as they see them.
        self._tokens = [AliveToken(session, key) for key in (run_key(robot, self.run), alive_key(robot))]
        self._names = NameWatch(session, robot, self.run, self._status.changed)
        claim.close()
        super().__init__(session)

    def next_sequence(self, extent: str) -> int:
        """Return the sequence number of the next message of an extent; it increases with every call.

        Raises:
            MessageError: the extent is unknown.
        """
        check_choice("extent", extent, EXTENTS)
        with self._lock:
            self._sequences[extent] += 1
            return self._sequences[extent]

    def publish(
        self,
        terrain: TerrainMessage,
        *,
        occupancy: Percent | None = None,
        summary: Callable[[], Payload] | None = None,
        regions: Callable[[], RegionsMessage] | None = None,
    ) -> None:
        """Publish a grid. Returns immediately; encoding and sending run on threads of the outbox.

        The Terrain message is sent before occupancy and grid map, and in parallel with summary and regions.

        Args:
            terrain: grid of either extent.
            occupancy: (ny, nx) int8 occupancy of the same grid; if given for extent "footprint", OccupancyGrid and
                GridMap are published too, unless another pause has begun since.
            summary: returns the encoded summary of a map, as from `encode_summary`; called on a thread of the outbox if
                there are subscribers.
            regions: returns the steppable regions of a map; called on a background thread if there are subscribers, or
                when the message is queried later.

        Raises:
            MessageError: the shape of `occupancy` differs from that of the grid, or the grid is from another robot.
            SessionClosed: the session is closed.
        """
        if terrain.robot != self.robot:
            raise MessageError(f"grid of robot {terrain.robot!r} given to the node of {self.robot!r}")
        if occupancy is not None and occupancy.shape != terrain.shape:
            raise MessageError(f"occupancy has shape {occupancy.shape}; the grid has {terrain.shape}")
        with self._lock:
            self._newest[terrain.extent] = terrain
            is_over = self._standing is not None and self._is_other_pause(terrain)
            if terrain.extent == "footprint" and not is_over:
                self._derived = terrain
            if self._standing is None and terrain.extent == "footprint":
                # No pauses are announced, as in a replay, so the newest scan defines the pause.
                self._step, self._epoch = terrain.step, terrain.epoch
            self._times = [*self._times[-9:], time.monotonic()]
        self._grids.post(terrain, summary, regions)
        if terrain.extent == "map" or not is_over:
            self._post_derived(terrain, occupancy)
        self._status.changed()

    def _is_other_pause(self, terrain: TerrainMessage) -> bool:
        return terrain.step != self._step or (terrain.epoch or self._epoch) != self._epoch

    def _answer(self, extent: str) -> TerrainMessage | None:
        """Return the newest grid for a query and count the answer. The client decides whether it may use the grid."""
        with self._lock:
            terrain = self._newest.get(extent)
            is_old = terrain is None or terrain.withdrawn or self._is_other_pause(terrain)
            if terrain is not None and terrain.scan_end_clock is not None:
                is_old |= clock.now() - terrain.scan_end_clock > terrain.valid_for
            self._answers += 1
            self._stale_answers += is_old
        return terrain

    def _post_derived(self, terrain: TerrainMessage, occupancy: Percent | None) -> None:
        if occupancy is not None and terrain.extent == "footprint":
            self._grids.post_derived(terrain, occupancy, self._bridge if self._draw is None else None)
        if self._draw is not None:
            draw = self._draw
            self.mirror(lambda: draw(terrain), lane=terrain.extent)

    def _empty(self, terrain: TerrainMessage) -> None:
        """Withdraw occupancy and grid map, whose readers cannot detect that the pause is over."""
        nothing = terrain.emptied(time.time_ns(), f"the pause of step {terrain.step} is over")
        self._post_derived(nothing, np.full(nothing.shape, 100, np.int8))

    def draw_with(self, draw: Callable[[TerrainMessage], Iterable[tuple[str, Any]]]) -> None:
        """For each grid, send to ROS 2 what `draw` returns: pairs (topic, message object) as in `mirror`.

        `publish` then no longer sends occupancy and grid map to ROS 2; `draw` should return them too.
        """
        self._draw = draw

    def mirror(self, make: Callable[[], Iterable[tuple[str, Any]]], *, lane: str) -> None:
        """Send message objects to ROS 2 if there is a bridge. Returns immediately.

        Args:
            make: returns pairs (topic, message object), with topics as in `Ros2Bridge.put`; called on a thread of the
                outbox.
            lane: name of a queue of length one, in which a new call replaces a waiting one.
        """
        bridge = self._bridge
        if bridge is None:
            return

        def send() -> None:
            for name, message in make():
                bridge.put(name, message.__msgtype__, encode(message))

        self._outbox.post(f"ros2 {lane}", send, lane=f"ros2 {lane}")

    def flush(self, timeout: float = SEND_TIMEOUT) -> None:
        """Wait until all waiting messages are sent; raise ReceiveTimeout if this takes longer than `timeout` [s]."""
        self._outbox.flush(timeout)

    def serve_scans(self, handler: Handler, *, admission: Admission | None = None) -> None:
        """Serve scan requests; see `ScanServer`. The final reply waits up to `SEND_TIMEOUT` for the grid to be sent.

        Raises:
            SessionClosed: the session is closed.
        """

        def run(job: ScanJob) -> TerrainMessage:
            terrain = handler(job)
            try:
                self._outbox.flush(SEND_TIMEOUT, lane=terrain.extent)
            except ReceiveTimeout as error:
                # The scan is complete, and after the reply the client still waits for the grid.
                logger.warning("grid of step %d: %s", terrain.step, error)
            return terrain

        self._scans = ScanServer(self._session, run, robot=self.robot, admission=admission)

    def gait_clock(self, on_news: Callable[[], None]) -> GaitClock:
        """Create and return the `GaitClock` of this robot, with `on_news` as its callback."""
        self._gait = GaitClock(self._session, self.robot, on_news)
        return self._gait

    def begin_step(self, step: int, epoch: str = "") -> None:
        """Report a new stance pause and its walk, and withdraw occupancy and grid map of the previous pause.

        Receivers compute the age of grids in pauses from the reported numbers. An empty `epoch` means the same walk.
        """
        with self._lock:
            self._step, self._epoch, self._standing = step, epoch or self._epoch, True
            newest = self._newest.get("footprint")
            if newest is not None and not self._is_other_pause(newest):
                # The newest grid is from an earlier pause with the same number. Skipping a sequence number makes
                # receivers reject it.
                self._sequences["footprint"] += 1
                self._given_up = self._sequences["footprint"]
            derived, self._derived = self._derived, None
        self._status.changed()
        if derived is not None:
            self._empty(derived)

    def end_step(self) -> None:
        """Report that the pause has ended: the robot moves, or its state is unknown."""
        with self._lock:
            is_news, self._standing = self._standing is not False, False
        if is_news:
            self._status.changed()

    def status_changed(self) -> None:
        """Send the status without waiting for its next period. Returns immediately."""
        self._status.changed()

    def status_items(self) -> list[StatusItem]:
        """Return the current status items, in the order in which they are sent."""
        with self._lock:
            newest, newest_map = self._newest.get("footprint"), self._newest.get("map")
            step, epoch, times = self._step, self._epoch, list(self._times)
        span = times[-1] - times[0] if len(times) > 1 else 0.0
        failed = self._outbox.failed
        values: dict[str, Any] = {
            "run": self.run,
            "clock_s": f"{clock.now():.6f}",
            "epoch": epoch,
            "standing": "" if self._standing is None else str(self._standing).lower(),
            "gait": "" if self._gait is None else self._gait.state,
            "step": "" if step is None else step,
            "last_scan_step": "" if newest is None else newest.step,
            "last_scan_sequence": "" if newest is None else max(newest.sequence, self._given_up),
            "last_map_sequence": "" if newest_map is None else newest_map.sequence,
            "last_scan_age_s": f"{time.monotonic() - times[-1]:.1f}" if times else "",
            "grids_per_s": f"{(len(times) - 1) / span:.2f}" if span > 0.0 else "0",
            "links": len(self._session.links()),
            "published": self._grids.count,
            "superseded": self._outbox.superseded,
            "failed": failed,
            "waiting": self._outbox.pending,
            "answers": self._answers,
            "answers_stale": self._stale_answers,
            "longest_put_ms": f"{1000.0 * self._outbox.longest:.1f}",
            "scanning": "" if self._scans is None else str(self._scans.is_busy).lower(),
        }
        message = f"failed messages: {failed}, last error: {self._outbox.last_error}" if failed else "publishing"
        own = StatusItem(
            name=STATUS_NAME,
            level=Health.WARN if failed else Health.OK,
            message=message,
            hardware_id=self.robot,
            values=values,
        )
        try:
            further = [] if self._collect is None else list(self._collect())
        except Exception as error:
            further = [
                StatusItem(name="status", level=Health.ERROR, message=f"status items could not be collected: {error}")
            ]
        names = [] if self._names is None else self._names.items()
        return [own, *names, *self._failures.items(), *self._jumps.items(), *further]

    def _release(self) -> None:
        # Close the outbox first; it sends its waiting messages for up to two seconds.
        self._outbox.close()
        resources: list[Any] = [self._failures, self._status, *self._tokens, self._names, self._scans, self._queries]
        for resource in (*resources, self._bridge, self._grids, self.views):
            if resource is not None:
                resource.close()


class JumpWatch:
    """Report of jumps of this machine's wall clock, checked whenever the status is collected."""

    def __init__(self, robot: str) -> None:
        """Start watching; `robot` is the instance name."""
        self._robot = robot
        self._detector = clock.JumpDetector()
        self._jump: tuple[float, float] | None = None

    def items(self) -> list[StatusItem]:
        """Return a status item if the clock jumped within the last `REPORTED_FOR` seconds, otherwise none."""
        jump, now = self._detector.jump(), clock.now()
        if jump:
            self._jump = (jump, now)
            logger.warning("the clock has jumped by %+.1f s; the ages of grids do not depend on it", jump)
        if self._jump is None or now - self._jump[1] > REPORTED_FOR:
            return []
        by, at = self._jump
        message = f"the clock jumped by {by:+.1f} s, {now - at:.0f} s ago; the ages of grids do not depend on it"
        return [StatusItem(name="clock", level=Health.WARN, message=message, hardware_id=self._robot)]
