"""Estimate of a node's monotonic clock, so that ages of grids do not depend on wall clocks."""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from transport import clock
from transport.grids.evidence import read_report
from transport.keys import status_key
from transport.links.recent import Recent
from transport.links.session import Session
from transport.messages.status_message import Status, decode_status
from transport.queries.remote_clock import ClockBound, RemoteClock

logger = logging.getLogger(__name__)
# Interval of queries of the node's clock [s].
PERIOD = 10.0
# A warning is logged if the wall clocks certainly differ by more than this [s], at the first reply and when the offset
# has changed by more than this since the previous reply.
LOGGED_CHANGE = 1.0


@dataclass(frozen=True, slots=True)
class ClockOffset:
    """Offset between the wall clocks of the node and of this machine.

    Attributes:
        offset: wall clock of the node minus wall clock of this machine [s].
        doubt: error bound of the offset [s].
        jumps: number of jumps of this machine's wall clock detected since the client was opened.
    """

    offset: float
    doubt: float
    jumps: int


class NodeClock(RemoteClock):
    """Monotonic clock of a node, bounded by queries of its status; a faster reply gives a tighter bound.

    Attributes:
        offset: offset between the two wall clocks; None until the node has reported its clock.
    """

    def __init__(self, session: Session, robot: str, report: Callable[[Status, float], str]) -> None:
        """Start to query the node on a background thread.

        Args:
            session: open session.
            robot: instance name.
            report: called with each status and the time at which it was queried [s]; returns the reason to reject the
                status, or "".
        """
        self._lock = threading.Lock()
        self._bounds: Recent[str, ClockBound] = Recent(8)
        self._report = report
        self.offset: ClockOffset | None = None
        self._jumps = 0
        self._detector = clock.JumpDetector()
        super().__init__(session, status_key(robot), period=PERIOD)

    def age(self, run: str, reading: float) -> float | None:
        """Return the time since the clock of a run of the node showed `reading` [s]; None if that clock is unknown.

        The node reads its clock after the query was sent; the age is computed from the time of sending, so it is never
        too small.
        """
        with self._lock:
            bound = self._bounds.get(run)
        return None if bound is None else max(0.0, clock.now() - bound.earliest(reading))

    def latest(self, run: str, reading: float) -> float:
        """Return the latest time at which the clock of a run can have shown `reading` [s]; infinity if unknown."""
        with self._lock:
            bound = self._bounds.get(run)
        return math.inf if bound is None else bound.latest(reading)

    def _take(self, payload: bytes, asked: float, answered: float) -> bool:
        wall = time.time_ns() - round((clock.now() - asked) * 1e9)
        status = decode_status(payload)
        if self._report(status, asked):
            # The reply is from a run that has ended or from another node.
            return False
        report = read_report(status, asked)
        if report is None or not (report.run and report.clock):
            return True
        bound = ClockBound(report.clock, asked, answered)
        with self._lock:
            before = self._bounds.get(report.run)
            self._bounds[report.run] = bound if before is None else before.after(bound)
        self._compare_wall_clocks(status.stamp, wall, answered - asked)
        return True

    def _compare_wall_clocks(self, node: int, own: int, round_trip: float) -> None:
        jump = self._detector.jump()
        if jump:
            self._jumps += 1
            logger.warning("this machine's clock has jumped by %+.1f s; the ages of grids do not depend on it", jump)
        offset = (node - own) * 1e-9 - round_trip / 2
        last = self.offset
        self.offset = ClockOffset(offset, round_trip / 2, self._jumps)
        if abs(offset) - round_trip > LOGGED_CHANGE and (last is None or abs(offset - last.offset) > LOGGED_CHANGE):
            logger.warning(
                "the node's clock is %.1f s %s of this machine's; the ages of grids do not depend on it",
                abs(offset),
                "ahead" if offset > 0 else "behind",
            )
