"""Estimate of another process's clock, bounded by a round trip: the clock is read between query and reply."""

from __future__ import annotations

import logging
import threading
from abc import abstractmethod
from dataclasses import dataclass

from transport import clock
from transport.exceptions import MessageError, SessionClosed, TransportError
from transport.links.session import Resource, Session
from transport.queries.asking import ask
from transport.supervision import join

logger = logging.getLogger(__name__)
# Interval of attempts while there is no reply [s].
RETRY = 0.5
ANSWER_TIMEOUT = 2.0
# Upper bound of the relative drift of two clocks: an NTP daemon slews a wall clock by up to 500 ppm, and oscillators
# add 50 ppm each.
DRIFT = 1e-3


@dataclass(frozen=True, slots=True)
class ClockBound:
    """Reading of another clock [s], shown between `asked` and `answered` on this machine's clock [s]."""

    reading: float
    asked: float
    answered: float

    def earliest(self, reading: float) -> float:
        """Return the earliest time on this machine's clock at which the other clock can have shown `reading` [s]."""
        since = reading - self.reading
        return self.asked + since - DRIFT * abs(since)

    def latest(self, reading: float) -> float:
        """Return the latest time on this machine's clock at which the other clock can have shown `reading` [s]."""
        since = reading - self.reading
        return self.answered + since + DRIFT * abs(since)

    def at(self, time: float) -> tuple[float, float]:
        """Return the other clock's reading at `time` on this machine's clock, and the bound of its error [s]."""
        middle = (self.asked + self.answered) / 2
        return self.reading + (time - middle), (self.answered - self.asked) / 2 + DRIFT * abs(time - middle)

    def after(self, newer: ClockBound) -> ClockBound:
        """Return the better of two bounds: the tighter one, or the newer one if the clock was set in between."""
        drift = DRIFT * (newer.answered - self.answered)
        was_set = (
            newer.reading - newer.asked < self.reading - self.answered - drift
            or newer.reading - newer.answered > self.reading - self.asked + drift
        )
        is_tighter = newer.answered - newer.asked <= self.answered - self.asked + drift
        return newer if was_set or is_tighter else self


class RemoteClock(Resource):
    """Clock of another process, queried periodically by a background thread.

    Attributes:
        key: key of the queryable that returns the time.
    """

    def __init__(self, session: Session, key: str, *, period: float) -> None:
        """Start to query the clock every `period` [s], or every `RETRY` seconds while there is no reply."""
        self.key, self._period = key, period
        self._tried = threading.Event()
        self._wake = threading.Event()
        super().__init__(session)
        self._thread = session.thread(f"transport-clock {key}", self._run)
        self._thread.start()

    def wake(self) -> None:
        """Let the thread query now instead of after the period, for example because the queryable has appeared."""
        self._tried.clear()
        self._wake.set()

    def wait(self, timeout: float) -> None:
        """Wait up to `timeout` [s] for a query to end after the last call of `wake`."""
        self._tried.wait(max(0.0, timeout))

    def ask(self, timeout: float = ANSWER_TIMEOUT) -> bool:
        """Query the clock on the calling thread; return True if a valid reply arrived.

        Raises:
            SessionClosed: the session is closed.
            TransportError: Zenoh rejected the query.
        """
        asked = clock.now()
        for answer in ask(self._session, self.key, b"", timeout):
            if answer.payload is not None:
                answered = clock.now()
                try:
                    if self._take(answer.payload, asked, answered):
                        return True
                except MessageError as error:
                    logger.warning("reply on %s refused: %s", self.key, error)
                    return False
        return False

    @abstractmethod
    def _take(self, payload: bytes, asked: float, answered: float) -> bool:
        """Process a reply, given the times of query and reply [s]; return False to wait for another reply.

        Raises:
            MessageError: the reply is not valid.
        """

    def _run(self) -> None:
        while not self.is_closed:
            self._wake.clear()
            try:
                has_answer = self.ask()
            except SessionClosed:
                return
            except TransportError as error:
                if self._session.is_closed:
                    return
                logger.debug("the clock on %s is not known: %s", self.key, error)
                has_answer = False
            self._tried.set()
            self._wake.wait(self._period if has_answer else RETRY)

    def _release(self) -> None:
        self._wake.set()
        self._tried.set()
        join(self._thread)
