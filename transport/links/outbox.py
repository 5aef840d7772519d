"""Background sender: callers never wait, and lanes never wait for each other."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable

from transport.exceptions import ReceiveTimeout, SessionClosed
from transport.supervision import Failure, join, supervised

logger = logging.getLogger(__name__)


class Outbox:
    """Runs actions on background threads, in order within a lane and in parallel across lanes.

    At most one action per key and lane waits: a newer one replaces it. The thread of an empty lane ends.

    Attributes:
        sent: number of actions that succeeded.
        superseded: number of actions that were replaced before they ran.
        failed: number of actions that raised.
        last_error: text of the last error, or "".
        longest: duration of the slowest action [s].
    """

    def __init__(self) -> None:
        """Start empty."""
        self._changed = threading.Condition()
        self._lanes: dict[str, dict[str, Callable[[], None]]] = {}
        self._threads: dict[str, threading.Thread] = {}
        self._closed = self._abandoned = False
        self.sent = self.superseded = self.failed = 0
        self.last_error = ""
        self.longest = 0.0

    @property
    def pending(self) -> int:
        """Number of actions that are waiting or running."""
        with self._changed:
            return sum(map(len, self._lanes.values())) + len(self._threads)

    def post(self, key: str, action: Callable[[], None], *, lane: str = "") -> None:
        """Queue an action; returns immediately.

        Args:
            key: name of the message; a waiting action with the same key and lane is dropped.
            action: function that encodes and sends.
            lane: name of the lane.

        Raises:
            SessionClosed: the outbox is closed.
        """
        with self._changed:
            if self._closed:
                raise SessionClosed(f"cannot send on {key!r}: the outbox is closed")
            waiting = self._lanes.setdefault(lane, {})
            if waiting.pop(key, None) is not None:
                self.superseded += 1
            waiting[key] = action
            if lane not in self._threads:
                # A daemon: a put that blocks on a broken link must not keep the interpreter alive; close() joins it.
                thread = supervised(
                    f"transport-outbox {lane}",
                    lambda: self._run(lane),
                    on_failure=lambda failure: self._on_failure(lane, failure),
                )
                self._threads[lane] = thread
                thread.start()

    def flush(self, timeout: float, *, lane: str | None = None) -> None:
        """Wait until all actions have run, or all actions of one lane.

        Raises:
            ReceiveTimeout: it took longer than `timeout` [s].
        """

        def is_empty() -> bool:
            return not self._threads if lane is None else lane not in self._threads

        with self._changed:
            if not self._changed.wait_for(is_empty, timeout):
                raise ReceiveTimeout(f"{self.pending} messages were not sent within {timeout:g} s")

    def close(self) -> None:
        """Run the waiting actions, for up to two seconds, and end the threads; safe to call twice."""
        with self._changed:
            self._closed = True
            threads = list(self._threads.values())
        join(*threads)
        self._abandoned = True

    def _on_failure(self, lane: str, failure: Failure) -> None:
        """Clear the lane if its thread has failed for good; the next action starts a new one."""
        if failure.is_final:
            with self._changed:
                self._lanes.pop(lane, None)
                self._threads.pop(lane, None)
                self.failed += 1
                self.last_error = str(failure)
                self._changed.notify_all()

    def _run(self, lane: str) -> None:
        while True:
            with self._changed:
                waiting = self._lanes[lane]
                if not waiting or self._abandoned:
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
                # Messages lost because the session was closed are not an error.
                is_expected = self._closed or isinstance(failure, SessionClosed)
                logger.log(logging.INFO if is_expected else logging.ERROR, "sending on %s failed: %s", key, failure)
            with self._changed:
                self.longest = max(self.longest, time.monotonic() - start)
                self.sent += not error
                self.failed += bool(error)
                self.last_error = error or self.last_error
