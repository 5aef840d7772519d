"""Whether a grid may be used, by its sender and its age: the same for every way of receiving it."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Mapping
from typing import Protocol, TypeVar

from transport import clock
from transport.exceptions import MessageError, StaleTerrain
from transport.keys import alive_key, run_key, status_key
from transport.liveliness import AliveWatcher, TokenWatcher
from transport.messages.status_message import STATUS_NAME, Status, decode_status, whole_number
from transport.node_clock import NodeClock
from transport.received import Received
from transport.receiver import NewestReceiver
from transport.seldom import Seldom
from transport.session import Session

NS = 1e-9
# The only frame that grids of this major version are in.
FRAME = "base_footprint"
# Runs of nodes that are over and may not speak again.
REMEMBERED = 64
# [s] Between two queries for news.
POLL = 0.05
logger = logging.getLogger(__name__)
ADVICE = "Wait for the next, ask for a scan, or give a larger max_age"


class Grid(Protocol):
    """What a grid of either extent, a summary and regions of a map say of themselves; each as in `TerrainMessage`."""

    @property
    def robot(self) -> str:
        """Instance name."""

    @property
    def extent(self) -> str:
        """Kind: "footprint", "map", "summary" or "regions"."""

    @property
    def frame_id(self) -> str:
        """Frame of the grid."""

    @property
    def run(self) -> str:
        """Identity of the run of the node."""

    @property
    def epoch(self) -> str:
        """Identity of the walk."""

    @property
    def sequence(self) -> int:
        """Number within the run."""

    @property
    def step(self) -> int:
        """Number of the stance pause."""

    @property
    def scan_end(self) -> int:
        """End of the scan [ns]."""

    @property
    def scan_end_clock(self) -> float | None:
        """End of the scan by a clock that never jumps [s]."""

    @property
    def valid_for(self) -> float:
        """Validity [s]."""

    @property
    def valid_pauses(self) -> int:
        """Validity in pauses."""


G = TypeVar("G", bound=Grid)


class GridJudge:
    """Knows the node of one robot: which run of it lives, what pause it is in, how its clock stands.

    Attributes:
        node: the node's sign of life.
        clock: the node's clock.
    """

    def __init__(self, session: Session, robot: str) -> None:
        """Watch the node and its status."""
        self._robot = robot
        self._lock = threading.Lock()
        self._run = ""
        self._over: dict[str, None] = {}
        self._sequences: dict[str, int] = {}
        self._unasked = Seldom(logger)
        self._live = TokenWatcher(session, run_key(robot, "*"))
        self._status = NewestReceiver(session, status_key(robot), decode_status, latched=False)
        self.clock = NodeClock(session, robot)
        self.node = AliveWatcher(session, alive_key(robot), lambda alive: self.clock.wake() if alive else None)

    def status(self) -> Status | None:
        """The newest status of the node, sent or asked for; None when none came yet.

        Raises:
            MessageError: the newest status is damaged.
        """
        received = self._status.latest()
        sent, asked = None if received is None else received.message, self.clock.status
        if sent is None or asked is None:
            return sent or asked
        return asked if _clock_of(asked) > _clock_of(sent) else sent

    def refusal(self, terrain: Grid, extent: str, *, is_newest: bool = True) -> str:
        """Why a grid that came must not be taken for one of this robot; empty when it may.

        Args:
            terrain: the grid.
            extent: extent that was asked for.
            is_newest: whether it must be newer than all before it, as in what is published; an answer need not be.
        """
        for what, given, wanted in (
            ("robot", terrain.robot, self._robot),
            ("extent", terrain.extent, extent),
            ("frame", terrain.frame_id, FRAME),
        ):
            if given != wanted:
                return f"it is of {what} {given!r}, not {wanted!r}"
        with self._lock:
            return self._refused_run(terrain) or (self._refused_order(terrain) if is_newest else "")

    def _refused_run(self, terrain: Grid) -> str:
        run = terrain.run
        # A sender that reports no run is one of an earlier version, or another tool: it is judged by order alone.
        if not run or run == self._run:
            return ""
        if run in self._over:
            return f"it is of run {run!r} of the node, and another has taken over since"
        live = self._live.names
        if self._run and self._run in live and run not in live:
            return f"it is of run {run!r}, which shows no sign of life, and run {self._run!r} lives"
        if self._run and self._run in live:
            return f"it is of run {run!r}, and run {self._run!r} lives too: two nodes have the name {self._robot!r}"
        if self._run:
            self._over[self._run] = None
            while len(self._over) > REMEMBERED:
                del self._over[next(iter(self._over))]
        self._run, self._sequences = run, {}
        return ""

    def _refused_order(self, terrain: Grid) -> str:
        # While no node has announced its run, any may have started again: its sequences mean nothing.
        last = self._sequences.get(terrain.extent, 0) if self._run else 0
        if terrain.sequence <= last:
            return f"its sequence {terrain.sequence} comes after {last}"
        self._sequences[terrain.extent] = terrain.sequence
        return ""

    def age(self, received: Received[G]) -> float:
        """[s] since the end of the scan of a received grid; where it is uncertain, rather too much than too little.

        Where the node reports its clock that never jumps, by that clock and this machine's. Else it is the time since
        the arrival, and before the arrival what the two wall clocks say.
        """
        terrain = received.message
        if terrain.scan_end_clock is not None:
            age = self.clock.age(terrain.run, terrain.scan_end_clock)
            if age is not None:
                return max(age, received.age)
            if self.node.is_alive:
                self._unasked.say(
                    "the node of %r does not answer for its clock: ages come from the wall clocks of both "
                    "machines. Access rules made by an earlier version? `guara security renew` on their machine",
                    self._robot,
                )
        return received.age + max(0.0, (received.arrival_stamp - terrain.scan_end) * NS)

    def check(self, received: Received[G], max_age: float | None, *, wait: float = 0.0) -> G:
        """The grid, if it may still be used.

        Args:
            received: grid with its arrival.
            max_age: [s] since the end of the scan; None takes the grid's own validity, in time and in pauses.
            wait: how long to wait for the first answer of a node that lives [s].

        Raises:
            StaleTerrain: it may not; the message says why and what to do.
        """
        terrain = received.message
        if self.node.is_alive:
            self.clock.wait(wait)
        age = self.age(received)
        limit = terrain.valid_for if max_age is None else max_age
        name = f"newest {terrain.extent} grid (step {terrain.step})"
        if age > limit:
            gone = "" if self.node.is_alive else "; its node is gone"
            raise StaleTerrain(f"{name} is {age:.2f} s old; allowed: {limit:g} s{gone}. {ADVICE}")
        if max_age is None:
            self._check_pauses(terrain, name)
        return terrain

    def wait_for_news(self, timeout: float) -> None:
        """Ask the node; where its pause is over, wait up to `timeout` [s] for the next one to begin."""
        deadline = clock.now() + timeout
        while self.node.is_alive and self.clock.ask(timeout):
            if self._values_of("").get("standing") != "false" or clock.now() > deadline:
                return
            time.sleep(POLL)

    def _check_pauses(self, terrain: Grid, name: str) -> None:
        values = self._values_of(terrain.run)
        epoch, step = values.get("epoch", ""), whole_number(values.get("step", ""))
        knows = _knows(values, terrain)
        if epoch and terrain.epoch and epoch != terrain.epoch:
            if knows:
                raise StaleTerrain(f"{name} is of walk {terrain.epoch!r}; the robot is on walk {epoch!r}. {ADVICE}")
            return
        pauses = 0 if step is None else step - terrain.step
        if pauses > terrain.valid_pauses:
            frame = "; the frame of a footprint ends with its pause" if terrain.extent == "footprint" else ""
            raise StaleTerrain(f"{name} is {pauses} pauses old; allowed: {terrain.valid_pauses}{frame}. {ADVICE}")

    def _values_of(self, run: str) -> Mapping[str, str]:
        try:
            status = self.status()
        except MessageError:
            status = self.clock.status
        item = None if status is None else status.item(STATUS_NAME)
        if item is None or (run and item.values.get("run", run) != run):
            return {}
        return item.values


def _knows(values: Mapping[str, str], terrain: Grid) -> bool:
    """Whether a status was made after a grid was published: it then knows better which walk the robot is on."""
    last = whole_number(values.get("last_scan_sequence" if terrain.extent == "footprint" else "last_map_sequence", ""))
    return last is not None and last >= terrain.sequence


def _clock_of(status: Status) -> float:
    item = status.item(STATUS_NAME)
    try:
        return float(item.values["clock_s"]) if item is not None else 0.0
    except (KeyError, ValueError):
        return 0.0
