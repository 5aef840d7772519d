"""The node's clock seen from here: how old its grids are, whatever the wall clocks say."""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from transport import clock
from transport.asking import ask
from transport.exceptions import MessageError, SessionClosed, TransportError
from transport.keys import status_key
from transport.messages.status_message import STATUS_NAME, Status, decode_status
from transport.resource import Resource
from transport.session import Session

logger = logging.getLogger(__name__)
# [s] Between two questions, and between attempts while nobody answers.
PERIOD = 10.0
RETRY = 0.5
ANSWER_TIMEOUT = 2.0
# [s] A bound this old is replaced by a new one even if that is looser: clocks drift by 50 ppm.
BOUND_LIFE = 60.0
# [s] A larger difference of the two wall clocks is logged.
WORTH_TELLING = 1.0
CLOSE_TIMEOUT = 2.0


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


@dataclass(frozen=True, slots=True)
class _Bound:
    """The node's clock read `clock` at some instant between `asked` and `answered` of this machine's clock."""

    clock: float
    asked: float
    answered: float

    @property
    def doubt(self) -> float:
        return self.answered - self.asked


class NodeClock(Resource):
    """Asks the node for its status now and then; the answer gives its clock, as exactly as the answer was quick."""

    def __init__(self, session: Session, robot: str, hear: Callable[[Status, float], str]) -> None:
        """Begin to ask, on a thread of its own; `hear` gets each answer, with the instant [s] at which it was asked."""
        self._key = status_key(robot)
        self._lock = threading.Lock()
        self._bounds: dict[str, _Bound] = {}
        self._hear = hear
        self._offset: ClockOffset | None = None
        self._jumps = 0
        self._detector = clock.JumpDetector()
        self._tried = threading.Event()
        self._wake = threading.Event()
        super().__init__(session)
        self._thread = session.thread(f"transport-clock {robot}", self._run)
        self._thread.start()

    @property
    def offset(self) -> ClockOffset | None:
        """Offset of the two wall clocks; None while the node has not answered."""
        return self._offset

    def wake(self) -> None:
        """Ask now: a node has come."""
        self._tried.clear()
        self._wake.set()

    def wait(self, timeout: float) -> None:
        """Wait until the node was asked at least once since it came, `timeout` [s] at most."""
        self._tried.wait(max(0.0, timeout))

    def age(self, run: str, reading: float) -> float | None:
        """[s] since the clock of a run of the node showed `reading`; None when that clock is not known.

        The node read its clock some time after it was asked; it is taken as read when asked, so that no age is too
        small.
        """
        with self._lock:
            bound = self._bounds.get(run)
        return None if bound is None else max(0.0, clock.now() - bound.asked + bound.clock - reading)

    def said(self, run: str, reading: float) -> float:
        """Latest instant [s] at which the clock of a run of the node showed `reading`; infinite when not known."""
        with self._lock:
            bound = self._bounds.get(run)
        return math.inf if bound is None else bound.answered - bound.clock + reading

    def ask(self, timeout: float = ANSWER_TIMEOUT) -> bool:
        """Ask now, in this thread; whether an answer came.

        Raises:
            SessionClosed: the session is closed.
        """
        asked, wall = clock.now(), time.time_ns()
        for answer in ask(self._session, self._key, b"", timeout):
            if answer.payload is not None:
                answered = clock.now()
                try:
                    status = decode_status(answer.payload)
                except MessageError as error:
                    logger.warning("answer on %s refused: %s", self._key, error)
                    return False
                if self._hear(status, asked):
                    # Of a run that is over, or of another node.
                    continue
                self._take(status, asked, answered, wall)
                return True
        return False

    def _take(self, status: Status, asked: float, answered: float, wall: int) -> None:
        item = status.item(STATUS_NAME)
        values = {} if item is None else item.values
        try:
            run, reading = values["run"], float(values["clock_s"])
        except (KeyError, ValueError):
            return
        bound = _Bound(reading, asked, answered)
        with self._lock:
            before = self._bounds.pop(run, None)
            if before is not None and bound.doubt > before.doubt and answered - before.answered < BOUND_LIFE:
                bound = before
            self._bounds[run] = bound
            while len(self._bounds) > 8:
                del self._bounds[next(iter(self._bounds))]
        self._compare_wall_clocks(status.stamp, wall, answered - asked)

    def _compare_wall_clocks(self, node: int, here: int, took: float) -> None:
        jump = self._detector.jump()
        if jump:
            self._jumps += 1
            logger.warning("this machine's clock has jumped by %+.1f s; the ages of grids do not depend on it", jump)
        offset = (node - here) * 1e-9 - took / 2
        last = self._offset
        self._offset = ClockOffset(offset, took / 2, self._jumps)
        if abs(offset) - took > WORTH_TELLING and (last is None or abs(offset - last.offset) > WORTH_TELLING):
            logger.warning(
                "the node's clock is %.1f s %s of this machine's; the ages of grids do not depend on it",
                abs(offset),
                "ahead" if offset > 0 else "behind",
            )

    def _run(self) -> None:
        while not self._is_closed:
            self._wake.clear()
            try:
                has_answer = self.ask()
            except SessionClosed:
                return
            except TransportError as error:
                if self._session.is_closed:
                    return
                logger.debug("the node's clock is not known: %s", error)
                has_answer = False
            self._tried.set()
            self._wake.wait(PERIOD if has_answer else RETRY)

    def _release(self) -> None:
        self._wake.set()
        self._tried.set()
        if self._thread is not threading.current_thread():
            self._thread.join(CLOSE_TIMEOUT)
