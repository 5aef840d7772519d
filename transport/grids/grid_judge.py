"""Acceptance of the grids of one robot, by the rule in `evidence`, and waiting for usable grids."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from numbers import Real
from typing import Any, TypedDict, cast

from transport import clock
from transport.exceptions import MessageError, ReceiveTimeout, ScannerGone, ScannerUnavailable, StaleTerrain
from transport.grids.evidence import SILENT, Cure, Evidence, G, Objection, read_report, silent_for
from transport.grids.node_clock import NodeClock
from transport.keys import PERCEPTION_VERSION, alive_key, alive_keys_of_all_versions, run_key, status_key
from transport.links.liveliness import AliveWatcher, TokenWatcher, alive_keys
from transport.links.received import Received
from transport.links.receiver import NewestReceiver
from transport.links.session import Session
from transport.messages.status_message import Status, StatusItem, decode_status
from transport.messages.terrain_message import Health
from transport.supervision import Seldom

NS = 1e-9
# Time from subscribing within which the node's liveliness token and, over a fast link, its last grid arrive [s]; below
# 0.1 s on an idle machine, more on a busy one. Only a wait for something that never arrives takes this long.
SETTLE = 2.0
# Interval of checks for new messages [s].
POLL = 0.05
# Longest wait for a reply from the node [s].
ANSWER = 1.0
logger = logging.getLogger(__name__)
ADVICE = "Wait for the next grid (wait_for_step), or request a scan (request_scan) while the robot stands"


@dataclass(frozen=True, slots=True)
class Terms:
    """Conditions under which a caller accepts grids.

    Attributes:
        max_age: allowed time since the end of the scan [s]; None = the validity of the grid itself.
        allow_stale: True = also accept stale grids, with the reasons in `stale_because`.
        confirmed_only: True = reject provisional grids.

    Raises:
        MessageError: `max_age` is negative, NaN or not numeric; no grid could meet it.
    """

    max_age: float | None = None
    allow_stale: bool = False
    confirmed_only: bool = False

    def __post_init__(self) -> None:
        """Check the fields."""
        if self.max_age is not None and not (isinstance(self.max_age, Real) and self.max_age >= 0.0):
            raise MessageError(f"max_age is {self.max_age!r}; allowed: 0 s or more, or None for the grid's validity")


TERMS = Terms()
# Conditions for a message that withdraws another grid: it is always accepted.
TAKING_BACK = Terms(allow_stale=True)


class Accepted(TypedDict, total=False):
    """Fields of `Terms` as keyword arguments."""

    max_age: float | None
    allow_stale: bool
    confirmed_only: bool


class GridJudge:
    """Acceptance check for the grids of one robot, and waiting for grids that pass it; monitors the robot's node.

    Attributes:
        node: monitor of the node's liveliness token.
        clock: estimate of the node's clock.
        refusal: records or rejects a received grid; see `Evidence.refusal`.
    """

    def __init__(self, session: Session, robot: str) -> None:
        """Start to monitor the node and its status."""
        self._session, self._robot = session, robot
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
        received, report = self._status.latest(), self._evidence.last_report
        if report is None:
            return None if received is None else received.message
        silence = clock.now() - report.heard
        if silence <= SILENT:
            return report.status
        text = f"the node {silent_for(silence)}; its last report may be outdated"
        item = StatusItem(name="node", level=Health.STALE, message=text)
        return replace(report.status, items=(*report.status.items, item))

    def _report(self, status: Status) -> str:
        report = read_report(status, clock.now())
        # A status may have waited in a queue, so its report may be older than its arrival.
        heard = clock.now() if report is None else min(report.heard, self.clock.latest(report.run, report.clock))
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
            if cure is not Cure.REPORT or not self.clock.ask(min(left, ANSWER)):
                time.sleep(min(left, POLL))
        reasons = tuple(f"the {grid.extent} grid of step {grid.step} {objection.text}" for objection in found)
        refused = [] if terms.allow_stale else [objection.text for objection in found]
        if terms.confirmed_only and grid.provisional:
            refused.append("is provisional, but a confirmed one is required")
        if refused:
            text = f"newest {grid.extent} grid (step {grid.step}) {', and '.join(refused)}. {ADVICE}"
            raise StaleTerrain(text, is_final=not found or cure is Cure.NONE)
        return grid if not reasons else cast(G, replace(cast(Any, grid), stale_because=reasons))

    def wait(
        self,
        receiver: NewestReceiver[G],
        predicate: Callable[[Received[G]], bool],
        timeout: float | None,
        terms: Terms,
        *,
        after: int = 0,
        says_stale: bool = False,
        takes_back: bool = False,
    ) -> Received[G]:
        """Wait until the newest message may be used and `predicate` accepts it; return the message.

        Args:
            receiver: receiver of the messages.
            predicate: called with each new message, or the newest of several; returns True to accept it.
            timeout: longest wait [s]; None = no limit.
            terms: conditions under which the caller accepts a message.
            after: number of a sample; only samples with larger numbers are considered.
            says_stale: True = if only unusable messages arrived, raise StaleTerrain instead of the other errors.
            takes_back: True = also accept a message that withdraws another one, with the reasons why it is stale.

        Raises:
            StaleTerrain: only unusable messages arrived, and `says_stale` is True.
            ReceiveTimeout: no accepted message arrived in time although the node is alive.
            ScannerGone: no accepted message arrived, and the node has disappeared.
            ScannerUnavailable: no accepted message arrived, and no node was ever seen.
            SessionClosed: the receiver is closed.
            MessageError: the timeout is NaN, which would never end, or not numeric.
        """
        if timeout is not None and (not isinstance(timeout, Real) or math.isnan(timeout)):
            raise MessageError(f"timeout is {timeout!r}; allowed: a number of seconds, or None for no limit")
        deadline = math.inf if timeout is None else clock.now() + timeout
        stale: StaleTerrain | None = None
        while True:
            left = deadline - clock.now()
            try:
                received = receiver.wait_until(predicate, None if timeout is None else max(left, 0.0), after=after)
                message = self.check(
                    received,
                    TAKING_BACK if takes_back and received.message.withdrawn else terms,
                    patience=max(0.0, min(left, SETTLE)),
                    is_superseded=partial(receiver.has_newer, received),
                )
                return replace(received, message=message)
            except StaleTerrain as error:
                stale = error
                left = deadline - clock.now()
                if error.is_final or left <= 0.0:
                    after = received.number
                else:
                    # The node may return and confirm the grid, so check the same grid again.
                    time.sleep(min(POLL, left))
            except ReceiveTimeout:
                if stale is not None and says_stale:
                    raise stale from None
                found = receiver.nothing(timeout or 0.0)
                raise self._not_received(found if stale is None else f"{found}; {stale}") from None

    def wait_for_news(self, timeout: float) -> None:
        """Query the node. If the robot's pause has ended, wait up to `timeout` [s] for the next pause to begin."""
        deadline = clock.now() + timeout
        while self.node.is_alive and self.clock.ask(timeout):
            report = self._evidence.last_report
            if report is None or report.standing is not False or clock.now() > deadline:
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

    def unavailable(self, found: str = "") -> ScannerUnavailable:
        """Make the error for a missing node; its message begins with `found`."""
        # Nodes of other major versions use other keys, so none of their messages are received.
        others = alive_keys(self._session, alive_keys_of_all_versions(self._robot))
        versions = sorted({key.split("/")[2] for key in others} - {PERCEPTION_VERSION})
        if versions:
            return ScannerUnavailable(
                f"{found}the node of robot {self._robot!r} uses version {', '.join(versions)} of the messages, but "
                f"this package uses {PERCEPTION_VERSION}: install the same version on both sides"
            )
        return ScannerUnavailable(
            f"{found}no node of robot {self._robot!r} was found: none is running on this router, the instance name "
            f"differs, or the role of this client's certificate does not permit reading"
        )

    def _not_received(self, found: str) -> ReceiveTimeout | ScannerGone | ScannerUnavailable:
        """Make the error for a wait without a result, depending on the state of the node."""
        if self.node.is_alive:
            return ReceiveTimeout(found)
        if self.node.was_seen:
            return ScannerGone(f"{found}; the node of {self._robot!r} disappeared")
        return self.unavailable(f"{found}; ")
