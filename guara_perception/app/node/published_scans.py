"""Published grids of the newest pause: confirmed, cut or withdrawn according to the announcements of the gait."""

from __future__ import annotations

import dataclasses
import functools
import logging
import math
from collections.abc import Callable

from guara_perception.app.messages import terrain_to_message
from guara_perception.app.node.consistency import ContactWatch
from guara_perception.app.node.journal import Journal
from guara_perception.app.node.live_scan import LiveScan
from guara_perception.app.node.node_status import NodeStatus
from guara_perception.app.node.pause import Pause
from guara_perception.app.node.recorder import ScanRecorder
from guara_perception.app.node.sweep import Swept
from guara_perception.app.node.walk_map import WalkMap
from guara_perception.app.publisher import send_terrain
from guara_perception.app.scene.scene import range_image_messages
from guara_perception.scanning.pictures import with_pictures
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.layers.record import Health
from kinematics import CameraMoved
from transport import Health as StatusLevel
from transport import TerrainMessage
from transport.keys import gait_clock_key
from transport.server import PerceptionServer

logger = logging.getLogger(__name__)
READ_TOO_EARLY = (
    "the joints that confirm the scan were read before it was complete. The robot must stand until the grid is "
    "published, or the gait must send HOLD"
)


@dataclasses.dataclass(slots=True, eq=False)
class Published:
    """Scan with a published grid.

    Attributes:
        pause: pause of the scan.
        swept: the scan and its processors.
        terrain: grid of the scan alone.
        fused: map with this scan; None while the scan is not in the map.
        is_confirmed: True if, at the last `settle`, the last frame was not later than `pause.still_until`.
        was_sent_provisional, was_map_provisional: True if the grid or the map was published as provisional.
        will_be_refined: True if a finer grid of the same pause follows, which is confirmed in its place.
    """

    pause: Pause
    swept: Swept
    terrain: TerrainGrid
    fused: TerrainGrid | None = None
    is_confirmed: bool = False
    was_sent_provisional: bool = False
    was_map_provisional: bool = False
    will_be_refined: bool = False


class PublishedScans:
    """Publisher of the grids and maps of successive pauses; used from one thread.

    Attributes:
        newest: scan of the current pause whose grid was published last; None if there is none or it was withdrawn.
        fused: scan of the current pause that is in the map, or None.
        doubts: doubts about the joint readings of the pause, added to the health of its grids.
    """

    def __init__(
        self,
        server: PerceptionServer,
        status: NodeStatus,
        walk_map: WalkMap,
        recorder: ScanRecorder | None,
        unseen: Callable[[Pause], TerrainGrid],
        journal: Journal | None = None,
    ) -> None:
        """Start without a published scan; `unseen` returns an all-unknown grid of a pause."""
        self._server, self._status, self._map, self._recorder = server, status, walk_map, recorder
        self._unseen, self._journal = unseen, journal
        self._unknown_clock = (
            f"the gait's clock is unknown ({gait_clock_key(server.robot)} gives no answer, or stamps are ahead of that "
            "clock), so no frame can be confirmed: grids stay provisional, and none stays in the map. Announce pauses "
            "with the StancePublisher of this version, or answer queries on that key (docs/messages.md); with "
            "certificates, run `guara security renew`"
        )
        self._are_images_out, self._contacts = False, ContactWatch(status)
        self.doubts: tuple[str, ...] = ()
        self.newest: Published | None = None
        self.fused: Published | None = None

    def begin(self, pause: Pause) -> None:
        """Finish the previous pause: withdraw unconfirmed grids, and keep a confirmed scan in the map."""
        before = self.newest or self.fused
        if before is None or before.pause is pause:
            return
        self.settle()
        if any(each is not None and not each.is_confirmed for each in (self.newest, self.fused)):
            self._withdraw(before.pause)
        if self.fused is not None:
            self._map.keep()
        self._are_images_out = False
        self.newest = self.fused = None

    def usable(self, pause: Pause, swept: Swept) -> Swept:
        """Part of a scan that may be published: all of it during the pause, the confirmed stripes afterwards.

        Raises:
            CameraMoved: no part of the scan may be published.
        """
        if not pause.ended.is_set() or pause.still_until >= swept.scan.last_frame:
            return swept
        cut = None if pause.broken else swept.until(pause.still_until)
        if cut is None:
            raise CameraMoved(self._why_not(pause))
        return cut

    def publish(self, pause: Pause, swept: Swept, *, will_be_refined: bool = False) -> TerrainMessage:
        """Publish the grid of a scan; `will_be_refined` is True if a finer grid of this pause follows."""
        terrain = dataclasses.replace(with_problems(swept.terrain, swept.scan, self.doubts), stamp=swept.scan.end)
        self.newest = Published(pause, swept, terrain, will_be_refined=will_be_refined)
        return self._send(self.newest, terrain)

    def publish_map(self) -> TerrainMessage:
        """Publish the map, after fusing the newest scan unless the map already has a scan of this pause."""
        if self.fused is None or self.fused.fused is None:
            assert self.newest is not None
            return self._fuse(self.newest)
        return self._send(self.fused, self.fused.fused)

    def take_back(self, pause: Pause, reason: str) -> TerrainMessage:
        """Withdraw the newest grid. A scan of its pause that was already fused stays in the map."""
        self.newest = None
        return send_terrain(self._server, self._nothing_seen(pause, reason))

    def settle(self) -> None:
        """Confirm, cut or withdraw the grids of the newest pause as the gait's latest announcements require."""
        newest, fused = self.newest, self.fused
        either = newest or fused
        if either is None:
            return
        pause = either.pause
        for published in dict.fromkeys(each for each in (fused, newest) if each is not None):
            was_confirmed = published.is_confirmed
            # Not permanent: a motion that is detected later may have begun before the last frame.
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

    def record_cut(self, pause: Pause, messages: list[TerrainMessage]) -> None:
        """Record a withdrawal, so that replays skip the recorded scan, then the grids cut to the confirmed stripes."""
        if self._recorder is not None:
            nothing = self._nothing_seen(pause, READ_TOO_EARLY)
            number = self._server.next_sequence("footprint")
            mark = terrain_to_message(nothing, robot=self._server.robot, sequence=number)
            self._recorder.add_terrains(pause.step, [mark, *messages])

    def _fuse(self, published: Published) -> TerrainMessage:
        """Fuse a scan into the map and publish the map."""
        pause, swept = published.pause, published.swept
        published.fused = self._map.update(
            pause.step,
            pause.stance,
            swept.wide(published.terrain),
            pause.known_ground,
            epoch=pause.epoch,
            time=swept.scan.last_frame,
            picture=swept.processor.ground_picture,
            standing_pauses=pause.standing_pauses,
        )
        refused = published.fused.metadata.get("visual_refused")
        self._status.note("texture", f"images do not correct the map: {refused}" if refused else "")
        told = published.fused.metadata.get("foot_slips") or {}
        slips = {f"{leg}_mm": f"{1e3 * slip:.1f}" for leg, slip in told.items()}
        text = f"standing feet slid by {', '.join(slips.values())} mm since the last pause" if slips else ""
        self._status.note("foot_slip", text, StatusLevel.OK, slips)
        if (pose := self._map.pose) is not None:
            self._contacts.add(published.fused, (*pose.stayed_feet, *pose.slipped_feet))
        self.fused = published
        if self._journal is not None:
            self._journal.write(self._map.claim(swept.scan.last_frame))
        return self._send(published, published.fused)

    def _confirm(self, published: Published) -> None:
        if published is self.fused and self._journal is not None:
            self._journal.confirm()
        if published.was_sent_provisional and published is self.newest:
            self._send(published, published.terrain)
        if published.was_map_provisional and published.fused is not None:
            self._send(published, published.fused)
        self._status.confirmed(published.pause.step)

    def _cut(self, newest: Published) -> None:
        """Publish a scan again without its unconfirmed stripes, after the regular end of a pause.

        An unconfirmed scan in the map is replaced too. If the remaining stripes show no cell, the scan is withdrawn.
        """
        pause = newest.pause
        cut = newest.swept.until(pause.still_until)
        if cut is None:
            self._withdraw(pause)
            return
        messages = [self.publish(pause, cut)]
        if self.fused is not None and not self.fused.is_confirmed:
            self._map.withdraw(self._nothing_seen(pause, READ_TOO_EARLY), time=cut.scan.last_frame)
            assert self.newest is not None
            messages.append(self._fuse(self.newest))
        self.record_cut(pause, messages)
        self.settle()

    def _withdraw(self, pause: Pause) -> None:
        """Withdraw the newest grid, and remove its pause from the map unless the fused scan was confirmed.

        A grid that was confirmed before the robot moved is correct, but the robot has left the frame of the grid.
        """
        reason = f"withdrawn: {self._why_not(pause)}"
        self._status.withdrawn("moved" if pause.broken else "late" if pause.is_clock_known else "clock")
        self._status.problem("scan", f"step {pause.step}: {reason}")
        logger.error("step %d: %s", pause.step, reason)
        nothing, messages = self._nothing_seen(pause, reason), []
        if self.newest is not None:
            messages.append(send_terrain(self._server, nothing))
        if self.fused is not None and not self.fused.is_confirmed:
            fused = self._map.withdraw(nothing, time=self.fused.swept.scan.last_frame)
            messages.append(send_terrain(self._server, fused, stated=walk_of(pause)))
            self.fused = None
        self.newest = None
        if self._recorder is not None:
            self._recorder.add_terrains(pause.step, messages)

    def _send(self, published: Published, terrain: TerrainGrid) -> TerrainMessage:
        """Publish a grid as provisional or confirmed. A provisional grid expires by the deadline of its pause."""
        pause, scan = published.pause, published.swept.scan
        is_provisional = published.will_be_refined or pause.still_until < scan.last_frame
        # A map is published as confirmed only after its journal is written, so that a node killed later can continue.
        is_map = terrain is published.fused
        is_provisional |= is_map and self._journal is not None and not published.is_confirmed
        published.was_map_provisional |= is_map and is_provisional
        published.was_sent_provisional |= not is_map and is_provisional
        limit = pause.deadline - scan.last_frame if is_provisional else math.inf
        if terrain is published.terrain and not is_provisional:
            processor = published.swept.processor
            self._send_images(pause.step, lambda: with_pictures(terrain, processor))
        return send_terrain(
            self._server,
            terrain,
            scan_start=scan.start,
            scan_end=scan.end,
            scan_end_clock=scan.last_frame,
            valid_for=max(limit, 0.0),
            stated=walk_of(pause, is_provisional=is_provisional) | {"refinement_follows": published.will_be_refined},
        )

    def _send_images(self, step: int, make: Callable[[], TerrainGrid]) -> None:
        """Publish and record the range images of a confirmed or withdrawn grid.

        Images of provisional grids are not sent, since an image message has no field for that state.

        Args:
            step: step of the pause.
            make: function that returns the grid with its images; called only if a subscriber, a query, the ROS 2 bridge
                or the recorder needs them.
        """
        messages = functools.cache(lambda: range_image_messages(make()))
        self._are_images_out = True
        self._server.views.send_range_images(messages)
        self._server.mirror(lambda: messages().items(), lane="range images")
        if self._recorder is not None:
            self._recorder.add_range_images(step, messages)

    def _why_not(self, pause: Pause) -> str:
        """Reason why the scan of an ended pause cannot be used."""
        return pause.broken or (READ_TOO_EARLY if pause.is_clock_known else self._unknown_clock)

    def _nothing_seen(self, pause: Pause, reason: str) -> TerrainGrid:
        """Make the all-unknown grid that withdraws another, with the reason; withdraw published range images too."""
        nothing = self._unseen(pause).restated(health=Health("failed", (reason,)), withdrawn=True, **walk_of(pause))
        if self._are_images_out:
            self._send_images(pause.step, lambda: with_pictures(nothing))
            self._are_images_out = False
        return nothing


def with_problems(terrain: TerrainGrid, scan: LiveScan, doubts: tuple[str, ...] = ()) -> TerrainGrid:
    """Add problems of the devices, an early stop, and doubts about the joints to the health of a grid."""
    if not scan.problems and not scan.stopped_early and not doubts:
        return terrain
    health = terrain.record.health or Health()
    early = ("the pause ended before the scan",) if scan.stopped_early else ()
    level = "failed" if scan.failed or health.level == "failed" else "degraded"
    return terrain.restated(health=Health(level, (*health.reasons, *scan.problems, *early, *doubts)))


def walk_of(pause: Pause, *, is_provisional: bool = False) -> dict[str, object]:
    """Record fields `epoch` and `provisional` of a grid of a pause."""
    return {"epoch": pause.epoch, "provisional": is_provisional}
