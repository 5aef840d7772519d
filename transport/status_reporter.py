"""Publishes the status of a node once a second and whenever it changes."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Sequence

from transport.exceptions import TransportError
from transport.keys import DEFAULT_ROBOT, status_key
from transport.publisher import SMALL, Publisher
from transport.resource import Resource
from transport.session import Session
from transport.status_message import Status, StatusItem, encode_status

logger = logging.getLogger(__name__)
# [s] Between two messages without change.
PERIOD = 1.0
CLOSE_TIMEOUT = 2.0


class StatusReporter(Resource):
    """Sends what `collect` returns, on a thread of its own."""

    def __init__(
        self,
        session: Session,
        collect: Callable[[], Sequence[StatusItem]],
        *,
        robot: str = DEFAULT_ROBOT,
        period: float = PERIOD,
    ) -> None:
        """Start reporting; `collect` runs on the reporter's thread and must be quick."""
        self._collect = collect
        self._period = period
        self._publisher = Publisher(session, status_key(robot), latched=False, priority=SMALL)
        self._wake = threading.Event()
        self._thread = threading.Thread(target=self._run, name="transport-status", daemon=True)
        super().__init__(session)
        self._thread.start()

    def changed(self) -> None:
        """Report now; returns at once."""
        self._wake.set()

    def _run(self) -> None:
        while not self._is_closed:
            self._wake.clear()
            self._report()
            self._wake.wait(self._period)

    def _report(self) -> None:
        try:
            status = Status(stamp=time.time_ns(), items=tuple(self._collect()))
            self._publisher.put(encode_status(status))
        except TransportError as error:
            if not self._is_closed:
                logger.error("status was not sent: %s", error)
        except Exception:
            logger.exception("collecting the status failed")

    def _release(self) -> None:
        self._wake.set()
        if self._thread is not threading.current_thread():
            self._thread.join(CLOSE_TIMEOUT)
        self._publisher.close()
