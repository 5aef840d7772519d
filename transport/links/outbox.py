"""Threads that send for others: whoever makes a message never waits, and lanes never wait for one another."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable

from transport.exceptions import ReceiveTimeout, SessionClosed
from transport.supervision import Failure, supervised

logger = logging.getLogger(__name__)
# Questions that may wait for an answer; more are dropped, so that a flood of them fills no memory.
MAXIMUM_PENDING = 64

# [s] How long closing waits for messages that are being sent.
CLOSE_TIMEOUT = 2.0


class Outbox:
    """Runs actions on threads of its own: those of one lane one after the other, oldest first, lanes side by side.

    In a lane at most one action of a key waits: a newer one of the same key replaces it, which is counted. A lane's
    thread lives while there is something to do.
    """

    def __init__(self) -> None:
        """Start empty."""
        self._changed = threading.Condition()
        self._lanes: dict[str, dict[str, Callable[[], None]]] = {}
        self._threads: dict[str, threading.Thread] = {}
        self._closed = False
        self._sent = 0
        self._superseded = 0
        self._failed = 0
        self._last_error = ""
        self._longest = 0.0

    @property
    def sent(self) -> int:
        """Actions that were run without error."""
        return self._sent

    @property
    def pending(self) -> int:
        """Actions that wait, and those that run."""
        with self._changed:
            return sum(map(len, self._lanes.values())) + len(self._threads)

    @property
    def superseded(self) -> int:
        """Actions that were replaced by a newer one before they ran."""
        return self._superseded

    @property
    def failed(self) -> int:
        """Actions that raised."""
        return self._failed

    @property
    def last_error(self) -> str:
        """Text of the last error, empty when there was none."""
        return self._last_error

    @property
    def longest(self) -> float:
        """[s] Time that the slowest action took."""
        return self._longest

    def post(self, key: str, action: Callable[[], None], *, lane: str = "") -> None:
        """Hand over an action; returns at once.

        Args:
            key: names what is sent; a waiting action of the same key and lane is dropped.
            action: function that encodes and sends.
            lane: name of the lane; its actions run in order, and no other lane waits for them.

        Raises:
            SessionClosed: the outbox is closed.
        """
        with self._changed:
            if self._closed:
                raise SessionClosed(f"cannot send on {key!r}: the outbox is closed")
            waiting = self._lanes.setdefault(lane, {})
            if waiting.pop(key, None) is not None:
                self._superseded += 1
            waiting[key] = action
            if lane not in self._threads:
                # A daemon: a put that a broken link holds must not keep the interpreter; close() joins it.
                thread = supervised(
                    f"transport-outbox {lane}",
                    lambda: self._run(lane),
                    on_failure=lambda failure: self._on_failure(lane, failure),
                )
                self._threads[lane] = thread
                thread.start()

    def flush(self, timeout: float, *, lane: str | None = None) -> None:
        """Wait until all that was posted, or all of one lane, has been sent.

        Raises:
            ReceiveTimeout: it took longer than `timeout` [s].
        """

        def is_empty() -> bool:
            return not self._threads if lane is None else lane not in self._threads

        with self._changed:
            if not self._changed.wait_for(is_empty, timeout):
                raise ReceiveTimeout(f"{self.pending} messages were not sent within {timeout:g} s")

    def close(self) -> None:
        """Send what waits, as far as that is quick, and end the threads; safe to call twice."""
        deadline = time.monotonic() + CLOSE_TIMEOUT
        with self._changed:
            self._closed = True
            threads = list(self._threads.values())
        for thread in threads:
            if thread is not threading.current_thread():
                thread.join(max(0.0, deadline - time.monotonic()))

    def _on_failure(self, lane: str, failure: Failure) -> None:
        """Leave the lane to a new thread, which the next action starts, when its own has failed for good."""
        if failure.is_final:
            with self._changed:
                self._lanes.pop(lane, None)
                self._threads.pop(lane, None)
                self._failed += 1
                self._last_error = str(failure)
                self._changed.notify_all()

    def _run(self, lane: str) -> None:
        while True:
            with self._changed:
                waiting = self._lanes[lane]
                if not waiting:
                    del self._lanes[lane], self._threads[lane]
                    self._changed.notify_all()
                    return
                key = next(iter(waiting))
                action = waiting.pop(key)
            start = time.monotonic()
            error = ""
            try:
                action()
            except Exception as failure:
                error = f"{key}: {failure}"
                logger.error("sending on %s failed: %s", key, failure)
            with self._changed:
                self._longest = max(self._longest, time.monotonic() - start)
                self._sent += not error
                self._failed += bool(error)
                self._last_error = error or self._last_error
