"""Clock of the node, by which grids are aged independently of the wall clocks."""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from transport import clock
from transport.grids.evidence import read_word
from transport.keys import status_key
from transport.links.recent import Recent
from transport.links.session import Session
from transport.messages.status_message import Status, decode_status
from transport.queries.remote_clock import ClockBound, RemoteClock

logger = logging.getLogger(__name__)
# [s] Between two questions.
PERIOD = 10.0
# [s] A larger difference of the two wall clocks is logged.
WORTH_TELLING = 1.0


@dataclass(frozen=True, slots=True)
class ClockOffset:
    """Offset of the node's wall clock from this machine's.

    Attributes:
        offset: to be added to this machine's clock to get the node's [s].
        doubt: largest error of the offset [s].
        jumps: how often this machine's wall clock has jumped since the client began.
    """

    offset: float
    doubt: float
    jumps: int


class NodeClock(RemoteClock):
    """Clock of the node, from its status; the quicker the answer, the smaller the uncertainty.

    Attributes:
        offset: offset of the two wall clocks; None while the node has not answered.
    """

    def __init__(self, session: Session, robot: str, report: Callable[[Status, float], str]) -> None:
        """Begin to ask on a thread of its own; `report` gets each answer and the instant of the question [s]."""
        self._lock = threading.Lock()
        self._bounds: Recent[str, ClockBound] = Recent(8)
        self._report = report
        self.offset: ClockOffset | None = None
        self._jumps = 0
        self._detector = clock.JumpDetector()
        super().__init__(session, status_key(robot), period=PERIOD)

    def age(self, run: str, reading: float) -> float | None:
        """[s] since the clock of a run of the node showed `reading`; None when that clock is not known.

        The node read its clock some time after it was asked; it is taken as read when asked, so that no age is too
        small.
        """
        with self._lock:
            bound = self._bounds.get(run)
        return None if bound is None else max(0.0, clock.now() - bound.earliest(reading))

    def said(self, run: str, reading: float) -> float:
        """Latest instant [s] at which the clock of a run of the node showed `reading`; infinite when not known."""
        with self._lock:
            bound = self._bounds.get(run)
        return math.inf if bound is None else bound.latest(reading)

    def _take(self, payload: bytes, asked: float, answered: float) -> bool:
        wall = time.time_ns() - round((clock.now() - asked) * 1e9)
        status = decode_status(payload)
        if self._report(status, asked):
            # Of a run that is over, or of another node.
            return False
        word = read_word(status, asked)
        if word is None or not (word.run and word.clock):
            return True
        bound = ClockBound(word.clock, asked, answered)
        with self._lock:
            before = self._bounds.get(word.run)
            self._bounds[word.run] = bound if before is None else before.after(bound)
        self._compare_wall_clocks(status.stamp, wall, answered - asked)
        return True

    def _compare_wall_clocks(self, node: int, here: int, took: float) -> None:
        jump = self._detector.jump()
        if jump:
            self._jumps += 1
            logger.warning("this machine's clock has jumped by %+.1f s; the ages of grids do not depend on it", jump)
        offset = (node - here) * 1e-9 - took / 2
        last = self.offset
        self.offset = ClockOffset(offset, took / 2, self._jumps)
        if abs(offset) - took > WORTH_TELLING and (last is None or abs(offset - last.offset) > WORTH_TELLING):
            logger.warning(
                "the node's clock is %.1f s %s of this machine's; the ages of grids do not depend on it",
                abs(offset),
                "ahead" if offset > 0 else "behind",
            )
