"""Status of a node: published once a second and on change, and sent as a reply to queries."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

from transport.exceptions import TransportError
from transport.keys import DEFAULT_ROBOT, status_key
from transport.links.answerer import Answerer
from transport.links.publisher import SMALL, Publisher
from transport.links.session import Resource, Session
from transport.messages.status_message import Status, StatusItem, encode_status
from transport.messages.typestore import STATUS, cdr
from transport.supervision import join

logger = logging.getLogger(__name__)
# Number of pulse periods (0.5 s each) between two periodic reports.
BEATS = 2
# Shortest time between two reports on change [s], so that a flood of events does not cause a flood of messages.
LEAST_GAP = 0.05


class StatusReporter(Resource):
    """Publisher of the status items that `collect` returns: once a second with the session's pulse, and on change."""

    def __init__(
        self,
        session: Session,
        collect: Callable[[], Sequence[StatusItem]],
        *,
        robot: str = DEFAULT_ROBOT,
    ) -> None:
        """Start to report; `collect` is called on several threads and must return quickly."""
        self._collect = collect
        self._beats = 0
        self._reporting = threading.Lock()
        self._publisher = Publisher(session, status_key(robot), latched=False, priority=SMALL, encoding=cdr(STATUS))
        self._answerer = Answerer(session, self._publisher.key, self._answer)
        self._followers: list[Callable[[bytearray], None]] = []
        self._wake = threading.Event()
        self._thread = session.thread("transport-status", self._run)
        super().__init__(session)
        self._wake.set()
        self._thread.start()
        session.pulse.add(self, self._on_beat, first=True)

    def changed(self) -> None:
        """Report the status soon, at least `LEAST_GAP` after the last report on change; returns immediately."""
        self._wake.set()

    def follow(self, take: Callable[[bytearray], None]) -> None:
        """Also pass the payload of each reported status to `take`, which must return quickly."""
        self._followers.append(take)

    def _run(self) -> None:
        while not self.is_closed:
            self._wake.wait()
            self._wake.clear()
            self._report()
            time.sleep(LEAST_GAP)

    def _on_beat(self) -> None:
        self._beats += 1
        if self._beats % BEATS == 0:
            self._report()

    def _answer(self, query: Any) -> None:
        query.reply(self._publisher.key, self._status(), encoding=cdr(STATUS))

    def _status(self) -> bytearray:
        return encode_status(Status(stamp=time.time_ns(), items=tuple(self._collect())))

    def _report(self) -> None:
        try:
            # Statuses must be sent in the order in which their items were collected.
            with self._reporting:
                payload = self._status()
                self._publisher.put(payload)
            for take in list(self._followers):
                take(payload)
        except TransportError as error:
            if not (self.is_closed or self._session.is_closed):
                logger.error("status was not sent: %s", error)
        except Exception:
            logger.exception("reporting the status failed")

    def _release(self) -> None:
        self._session.pulse.remove(self)
        self._wake.set()
        self._answerer.close()
        join(self._thread)
        self._publisher.close()
