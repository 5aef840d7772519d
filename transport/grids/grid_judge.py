"""Acceptance of the grids of one robot, by the rule in `evidence`."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, TypedDict, cast

from transport import clock
from transport.exceptions import MessageError, StaleTerrain
from transport.grids.evidence import SILENT, Cure, Evidence, G, Objection, read_word, silent_for
from transport.grids.node_clock import NodeClock
from transport.keys import alive_key, run_key, status_key
from transport.links.liveliness import AliveWatcher, TokenWatcher
from transport.links.received import Received
from transport.links.receiver import NewestReceiver
from transport.links.session import Session
from transport.messages.status_message import Status, StatusItem, decode_status
from transport.messages.terrain_message import Health
from transport.supervision import Seldom

NS = 1e-9
# Interval of checks for new messages [s].
POLL = 0.05
# Longest wait for a reply from the node [s].
ANSWER = 1.0
logger = logging.getLogger(__name__)
ADVICE = "Wait for the next (wait_for_step), or ask for a scan (request_scan) while the robot stands"


@dataclass(frozen=True, slots=True)
class Terms:
    """Conditions under which a caller accepts grids.

    Attributes:
        max_age: allowed time since the end of the scan [s]; None = the validity of the grid itself.
        allow_stale: True = also accept stale grids, with the reasons in `stale_because`.
        confirmed_only: True = reject provisional grids.

    Raises:
        MessageError: `max_age` is negative or NaN, which no grid could meet.
    """

    max_age: float | None = None
    allow_stale: bool = False
    confirmed_only: bool = False

    def __post_init__(self) -> None:
        """Check the fields."""
        if self.max_age is not None and not self.max_age >= 0.0:
            raise MessageError(f"max_age is {self.max_age:g}; allowed: 0 s or more, or None for its own validity")


TERMS = Terms()
# Conditions for a message that withdraws another grid: it is always accepted.
TAKING_BACK = Terms(allow_stale=True)


class Accepted(TypedDict, total=False):
    """Fields of `Terms` as keyword arguments."""

    max_age: float | None
    allow_stale: bool
    confirmed_only: bool


class GridJudge:
    """Acceptance check for the grids of one robot; monitors the robot's node.

    Attributes:
        node: monitor of the node's liveliness token.
        clock: estimate of the node's clock.
        refusal: records or rejects a received grid; see `Evidence.refusal`.
    """

    def __init__(self, session: Session, robot: str) -> None:
        """Start to monitor the node and its status."""
        self._robot = robot
        self._unasked = Seldom(logger)
        self._evidence = evidence = Evidence(robot)
        self.refusal = evidence.refusal
        self._live = TokenWatcher(session, run_key(robot, "*"), evidence.tokens)
        self.clock = NodeClock(session, robot, evidence.report)
        self._status = NewestReceiver(session, status_key(robot), decode_status, latched=False, refusal=self._report)
        self.node = AliveWatcher(session, alive_key(robot), lambda alive: self.clock.wake() if alive else None)

    def status(self) -> Status | None:
        """Return the newest status of the node, published or queried, or None before the first.

        A status whose report is older than `SILENT` gets an additional item `node` of level STALE.

        Raises:
            MessageError: the newest status is damaged.
        """
        received, word = self._status.latest(), self._evidence.word
        if word is None:
            return None if received is None else received.message
        silence = clock.now() - word.heard
        if silence <= SILENT:
            return word.status
        text = f"the node {silent_for(silence)}; its last report may be outdated"
        item = StatusItem(name="node", level=Health.STALE, message=text)
        return replace(word.status, items=(*word.status.items, item))

    def _report(self, status: Status) -> str:
        word = read_word(status, clock.now())
        # A status may have waited in a queue, so its report may be older than its arrival.
        heard = clock.now() if word is None else min(word.heard, self.clock.latest(word.run, word.clock))
        return self._evidence.report(status, heard)

    def age(self, received: Received[G]) -> float:
        """Return an upper bound of the time since the end of the scan of a received grid [s].

        If the node reports its monotonic clock, the age is measured by the monotonic clocks of both machines.
        Otherwise, it is the time since arrival plus the time from the end of the scan to the arrival. The latter is the
        difference of two stamps, one from each machine's wall clock, so the wall clocks must agree.
        """
        terrain = received.message
        if terrain.scan_end_clock is not None:
            age = self.clock.age(terrain.run, terrain.scan_end_clock)
            if age is not None:
                return max(age, received.age)
            if self.node.is_alive:
                self._unasked.log(
                    "the node of %r does not report its clock: ages are computed from the wall clocks of both "
                    "machines. If its access rules were made by an earlier version, run `guara security renew`",
                    self._robot,
                )
        return received.age + max(0.0, (received.arrival_stamp - terrain.scan_end) * NS)

    def check(
        self,
        received: Received[G],
        terms: Terms = TERMS,
        *,
        patience: float = 0.0,
        is_superseded: Callable[[], bool] = lambda: False,
    ) -> G:
        """Return the grid if `terms` accept it; objections that `allow_stale` overrides are listed in `stale_because`.

        Args:
            received: grid with its time of arrival.
            terms: conditions of the caller.
            patience: longest wait for a message that may resolve the objections [s].
            is_superseded: returns True if a newer grid has arrived, which ends the wait.

        Raises:
            StaleTerrain: the grid may not be used; the error message gives the reasons and what to do.
            SessionClosed: the session is closed, and the node would have to be queried.
        """
        grid, deadline = received.message, clock.now() + patience
        if self.node.is_alive:
            self.clock.wait(patience)
        while True:
            found = self._against(received, terms)
            cure = min((objection.cure for objection in found), default=Cure.NONE)
            left = deadline - clock.now()
            if cure <= Cure.RETURN or left <= 0.0 or is_superseded():
                break
            if cure is not Cure.WORD or not self.clock.ask(min(left, ANSWER)):
                time.sleep(min(left, POLL))
        reasons = tuple(f"the {grid.extent} grid of step {grid.step} {objection.text}" for objection in found)
        refused = [] if terms.allow_stale else [objection.text for objection in found]
        if terms.confirmed_only and grid.provisional:
            refused.append("is provisional, but a confirmed one is required")
        if refused:
            text = f"newest {grid.extent} grid (step {grid.step}) {', and '.join(refused)}. {ADVICE}"
            raise StaleTerrain(text, is_final=not found or cure is Cure.NONE)
        return grid if not reasons else cast(G, replace(cast(Any, grid), stale_because=reasons))

    def wait_for_news(self, timeout: float) -> None:
        """Query the node. If the robot's pause has ended, wait up to `timeout` [s] for the next pause to begin."""
        deadline = clock.now() + timeout
        while self.node.is_alive and self.clock.ask(timeout):
            word = self._evidence.word
            if word is None or word.standing is not False or clock.now() > deadline:
                return
            time.sleep(POLL)

    def _against(self, received: Received[G], terms: Terms) -> tuple[Objection, ...]:
        grid, evidence = received.message, self._evidence
        return evidence.against(
            grid,
            age=self.age(received),
            limit=grid.valid_for if terms.max_age is None else terms.max_age,
            now=clock.now(),
            was_lost=self.node.was_seen and not self.node.is_alive,
        )
