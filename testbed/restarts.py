"""Simulation of a robot, its gait, its nodes and a planner's client on an emulated clock, with the truth.

Of the client, only its evidence (`transport.grids.evidence`) is real; Zenoh is not used. The link to the planner
delivers everything in order after a delay. A link that is cut stalls, and is closed on both sides after `LEASE`. A node
detects the loss of the gait when the gait's clock has not replied for `GAIT_SILENT`.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from typing import Any

from transport.grids.evidence import SILENT, Cure, Evidence, Objection, read_report
from transport.messages.status_message import STATUS_NAME, Status, StatusItem
from transport.messages.terrain_message import Health
from transport.stance_link import GAIT_SILENT

# Period of the status without changes, time without messages after which a link is closed, and time step [s].
PERIOD, LEASE, TICK = 1.0, 2.0, 0.05
EXTENTS = ("footprint", "map")
VALID_FOR = 420.0


@dataclass(frozen=True, slots=True)
class Grid:
    """Grid with the fields that the evidence reads; `pose` is the number of the true pose of the scan."""

    extent: str
    run: str
    epoch: str
    sequence: int
    step: int
    scan_end_clock: float
    provisional: bool
    withdrawn: bool
    valid_pauses: int
    pose: int
    robot: str = "guara"
    frame_id: str = "base_footprint"
    scan_end: int = 0
    valid_for: float = VALID_FOR
    stale_because: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Said:
    """Announcement of the gait; `pose` is the number of the true pose at its joint readings."""

    epoch: str
    step: int
    pose: int
    is_begin: bool


@dataclass(slots=True)
class Node:
    """Run of a node, which receives announcements and confirms or withdraws its scan at the end of a pause."""

    run: str
    is_healthy: bool
    is_hung: bool = False
    is_mute: bool = False
    heard: float = math.inf
    pause: Said | None = None
    standing: bool | None = None
    sequences: dict[str, int] = field(default_factory=lambda: dict.fromkeys(EXTENTS, 0))
    newest: dict[str, Grid] = field(default_factory=dict)


class World:
    """True state of the robot, the newest node, the link to the planner, and the evidence of the planner."""

    def __init__(self, delay: float = 0.0) -> None:
        """Start before the first pause and without a node; `delay` is that of the link [s]."""
        self.delay, self.now = delay, 0.0
        self.walk, self.step, self.pose, self.stands = 0, 0, 0, False
        self.evidence = Evidence("guara")
        # Newest accepted `Grid` by extent. It has only those fields of a message that the evidence reads.
        self.held: dict[str, Any] = {}
        self.node: Node | None = None
        self.cut_since = self.deaf_since = math.inf
        self._nodes = 0
        # Time at which the robot arrived at each pose, and time at which END showed a motion during the scan there.
        self._came: dict[int, float] = {0: 0.0}
        self._refuted: dict[int, float] = {}
        self._began: dict[str, float] = {}
        self._last: Said | None = None
        self._broken = self._unheard = -math.inf
        self._hung_since = math.inf
        self._next_status = 0.0
        self._losing: set[str] = set()
        self._wire: deque[tuple[float, str, Any]] = deque()

    # The gait.

    def begin(self, *, new_walk: bool = False) -> None:
        """Begin the next pause, at another pose."""
        self.walk, self.step = (self.walk + 1, 0) if new_walk else (self.walk, self.step + 1)
        self._move()
        self.stands = True
        self._began.setdefault(self.epoch, self.now)
        self._announce(is_begin=True)

    def end(self, *, moved: bool = False) -> None:
        """End the pause, at the pose of BEGIN or, if `moved`, at another one."""
        self.stands = False
        if moved:
            self._refuted[self.pose] = self.now
            self._move()
        self._announce(is_begin=False)

    @property
    def epoch(self) -> str:
        """Identity of the walk."""
        return f"walk-{self.walk}"

    def _move(self) -> None:
        self.pose += 1
        self._came[self.pose] = self.now

    def _announce(self, *, is_begin: bool) -> None:
        # The gait's publisher keeps its last announcement for nodes that start later.
        self._last = Said(self.epoch, self.step, self.pose, is_begin)
        self._hear()

    # The node.

    def _hear(self) -> None:
        node, said = self.node, self._last
        if node is None or node.is_hung or said is None or self.deaf_since < math.inf:
            return
        pause = node.pause
        is_same = pause is not None and (pause.epoch, pause.step) == (said.epoch, said.step)
        if is_same and node.standing and said.is_begin and pause is not None and pause.pose == said.pose:
            return
        if node.standing:
            # An END or BEGIN of another pause ends this pause without confirming its scan.
            node.standing = False
            self._tell(node)
            self._settle(
                node, confirmed=is_same and not said.is_begin and pause is not None and pause.pose == said.pose
            )
        if said.is_begin or not is_same:
            node.pause, node.standing = said, said.is_begin
            self._tell(node)

    def _settle(self, node: Node, *, confirmed: bool) -> None:
        for extent in EXTENTS:
            grid = node.newest.get(extent)
            if grid is not None and node.pause is not None and grid.pose == node.pause.pose and not grid.withdrawn:
                self._publish(node, extent, provisional=False, withdrawn=not confirmed)

    def start(self, *, is_healthy: bool = True) -> None:
        """Start a new run, unless a node is running."""
        if self.node is None:
            self._nodes += 1
            # The node queries the gait's clock as it starts. A pause whose gait is lost before the first reply expires
            # in the node itself, which the tests of the node cover; it does not occur here.
            heard = math.inf if self.deaf_since < math.inf else self.now
            self.node = Node(f"run-{self._nodes}", is_healthy, heard=heard)
            self._send(self.node.run, True)
            self._tell(self.node)
            self._hear()

    def kill(self) -> None:
        """Kill the node (SIGKILL); only its links are closed."""
        if self.node is not None:
            self._send(self.node.run, False)
            self.node, self._hung_since = None, math.inf

    def hang(self) -> None:
        """Suspend the node (SIGSTOP): it neither sends nor receives, but its links stay open."""
        if self.node is not None and not self.node.is_hung:
            self.node.is_hung, self._hung_since = True, self.now

    def wake(self) -> None:
        """Resume the node (SIGCONT): it receives the last announcement."""
        if self.node is not None and self.node.is_hung:
            self.node.is_hung, self._hung_since = False, math.inf
            self._send(self.node.run, True)
            self._hear()
            self._tell(self.node)

    def deafen(self) -> None:
        """Cut the link between gait and node."""
        self.deaf_since = min(self.deaf_since, self.now)

    def listen(self) -> None:
        """Restore the link between gait and node: the last announcement arrives, and the clock replies."""
        self.deaf_since = math.inf
        if self.node is not None and not self.node.is_hung:
            self.node.heard = self.now
        self._hear()

    def mute(self) -> None:
        """Stop the sending threads of the node for good, while its links stay open."""
        if self.node is not None:
            self.node.is_mute = True

    def lose(self) -> None:
        """Lose the next grid of each extent on the link."""
        self._losing.update(EXTENTS)

    def scan(self) -> None:
        """Scan at the pause, and publish both extents as provisional."""
        node = self.node
        if node is not None and node.is_healthy and not node.is_hung and node.standing:
            for extent in EXTENTS:
                self._publish(node, extent, provisional=True)

    def _publish(self, node: Node, extent: str, *, provisional: bool, withdrawn: bool = False) -> None:
        pause = node.pause
        if pause is None:
            return
        node.sequences[extent] += 1
        node.newest[extent] = Grid(
            extent=extent,
            run=node.run,
            epoch=pause.epoch,
            sequence=node.sequences[extent],
            step=pause.step,
            scan_end_clock=self.now,
            provisional=provisional,
            withdrawn=withdrawn,
            valid_pauses=0 if extent == "footprint" else 40,
            pose=pause.pose,
        )
        if extent in self._losing:
            self._losing.discard(extent)
        else:
            self._send(node.run, node.newest[extent])
        self._tell(node)

    def _tell(self, node: Node) -> None:
        self._send(node.run, self._status(node))

    def _status(self, node: Node) -> Status:
        values = {
            "run": node.run,
            "clock_s": repr(self.now),
            "epoch": "" if node.pause is None else node.pause.epoch,
            "step": "" if node.pause is None else str(node.pause.step),
            "standing": "" if node.standing is None else str(node.standing).lower(),
            "gait": "silent" if self.now - node.heard > GAIT_SILENT else "",
            "last_scan_sequence": str(node.sequences["footprint"] or ""),
            "last_map_sequence": str(node.sequences["map"] or ""),
        }
        return Status(stamp=0, items=(StatusItem(name=STATUS_NAME, level=Health.OK, values=values),))

    # The link.

    @property
    def is_cut(self) -> bool:
        """True while the link to the planner is cut."""
        return self.cut_since < math.inf

    def cut(self) -> None:
        """Cut the link to the planner."""
        self.cut_since = min(self.cut_since, self.now)

    def heal(self) -> None:
        """Restore the link to the planner."""
        if self.is_cut:
            was_closed = self.now - self.cut_since > LEASE
            self.cut_since = math.inf
            if was_closed:
                self._join()

    def restart_router(self) -> None:
        """Close all links, which both sides notice, and open them again."""
        self._wire.clear()
        self.evidence.tokens(frozenset())
        if not self.is_cut:
            self._join()

    def _join(self) -> None:
        """Deliver token and last grids to the planner, as to a late joiner; the status follows with its next period."""
        node = self.node
        if node is not None and not node.is_hung:
            self._send(node.run, True)
            for grid in node.newest.values():
                self._send(node.run, grid)

    def _send(self, run: str, what: Status | Grid | bool) -> None:
        is_mute = self.node is not None and self.node.is_mute and not isinstance(what, bool)
        if not is_mute and (self.now - self.cut_since <= LEASE or not self.is_cut):
            self._wire.append((self.now + self.delay, run, what))

    def pass_time(self, seconds: float) -> None:
        """Advance the clock by a time [s]."""
        until = self.now + seconds
        while self.now < until:
            self.now = min(until, self.now + TICK)
            node = self.node
            if node is not None and not node.is_hung and self.deaf_since == math.inf:
                node.heard = self.now
            if node is not None and not node.is_hung and self.now >= self._next_status:
                self._next_status = self.now + PERIOD
                self._tell(node)
            if self.deaf_since < math.inf:
                self._unheard = self.now
            if self.is_cut or self.now >= self._hung_since or (node is not None and node.is_mute):
                self._broken = self.now
            if self.now - self.cut_since > LEASE:
                self._wire.clear()
                self.evidence.tokens(frozenset())
            if node is not None and self.now - self._hung_since > LEASE:
                self._send(node.run, False)
                self._hung_since = math.inf
            self._deliver()

    def _deliver(self) -> None:
        while self._wire and self._wire[0][0] <= self.now and not self.is_cut:
            _, run, what = self._wire.popleft()
            if isinstance(what, bool):
                live = self.evidence.live
                self.evidence.tokens(live | {run} if what else live - {run})
            elif isinstance(what, Status):
                # A client knows the node's clock up to the delay, so a delayed report counts as older than its arrival.
                report = read_report(what, self.now)
                self.evidence.report(what, self.now if report is None else min(self.now, report.clock + self.delay))
            elif not self.evidence.refusal(what, what.extent):
                self.held[what.extent] = what

    # The planner, and the oracle.

    def against(self, extent: str, limit: float = VALID_FOR, *, was_lost: bool = False) -> tuple[Objection, ...]:
        """List the objections to the planner's grid; the node is queried if its report may resolve them."""
        self._deliver()
        found = self._against(extent, limit, was_lost)
        node = self.node
        can_ask = node is not None and not node.is_hung and not node.is_mute and not self.is_cut
        if found and min(objection.cure for objection in found) is Cure.REPORT and can_ask and node is not None:
            self.evidence.report(self._status(node), self.now)
            found = self._against(extent, limit, was_lost)
        return found

    def _against(self, extent: str, limit: float, was_lost: bool) -> tuple[Objection, ...]:
        grid = self.held[extent]
        age = self.now - grid.scan_end_clock
        return self.evidence.against(grid, age=age, limit=limit, now=self.now, was_lost=was_lost)

    def contradicted_for(self, extent: str) -> float:
        """Time since the planner's grid became invalid in truth [s]; -inf if it is valid."""
        grid = self.held[extent]
        since = [self._refuted[grid.pose]] if grid.pose in self._refuted else []
        if grid.withdrawn:
            since.append(-math.inf)
        if extent == "footprint":
            since += [when for pose, when in self._came.items() if pose > grid.pose]
        if grid.epoch != self.epoch:
            since.append(min(when for epoch, when in self._began.items() if int(epoch[5:]) > int(grid.epoch[5:])))
        return self.now - min(since) if since else -math.inf

    def promised(self) -> float:
        """Longest time in which the planner must learn of an announcement [s], including time-outs of broken links."""
        is_broken = self.is_cut or self.now - self._broken <= SILENT + 2 * TICK
        # A node that does not receive the gait reports this in its next status.
        is_unheard = self.deaf_since < math.inf or self.now - self._unheard <= PERIOD
        return self.delay + 2 * TICK + SILENT * is_broken + (GAIT_SILENT + PERIOD) * is_unheard

    def must_be_used(self, extent: str) -> bool:
        """True if the planner must accept its grid: the node is alive and was received, and the grid is valid."""
        grid, node = self.held[extent], self.node
        is_deaf = self.deaf_since < math.inf
        is_heard = node is not None and not (node.is_hung or node.is_mute or self.is_cut or is_deaf or self._wire)
        is_of_it = node is not None and grid.run == node.run and grid == node.newest.get(extent)
        return is_heard and is_of_it and self.contradicted_for(extent) == -math.inf
