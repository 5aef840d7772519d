"""Background sender: callers do not wait for a transmission, nor does one lane wait for another."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable

from transport.exceptions import ReceiveTimeout, SessionClosed
from transport.supervision import Failure, join, supervised

logger = logging.getLogger(__name__)


class Outbox:
    """Queue of actions that run on background threads: in order within a lane, in parallel across lanes.

    In each lane, at most one action per key waits; a newer one replaces it. The thread of a lane ends when the lane is
    empty.

    Attributes:
        sent: number of actions that succeeded.
        superseded: number of actions that were replaced before they ran.
        failed: number of actions that raised an exception, and of lanes that failed for good.
        last_error: text of the last error, or "" if there was none.
        longest: duration of the slowest action [s].
    """

    def __init__(self) -> None:
        """Start without lanes."""
        self._changed = threading.Condition()
        self._lanes: dict[str, dict[str, Callable[[], None]]] = {}
        self._threads: dict[str, threading.Thread] = {}
        self._closed = self._abandoned = False
        self.sent = self.superseded = self.failed = 0
        self.last_error = ""
        self.longest = 0.0

    @property
    def pending(self) -> int:
        """Number of waiting actions plus running threads: an upper bound of the actions that have not ended."""
        with self._changed:
            return sum(map(len, self._lanes.values())) + len(self._threads)

    def post(self, key: str, action: Callable[[], None], *, lane: str = "") -> None:
        """Queue an action; returns immediately.

        Args:
            key: name of the message; a waiting action with the same key and lane is dropped.
            action: function that encodes and sends the message.
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
                # A daemon, because a put that blocks on a broken link must not keep the interpreter alive; close()
                # joins it.
                thread = supervised(
                    f"transport-outbox {lane}",
                    lambda: self._run(lane),
                    on_failure=lambda failure: self._on_failure(lane, failure),
                )
                self._threads[lane] = thread
                thread.start()

    def flush(self, timeout: float, *, lane: str | None = None) -> None:
        """Wait until all actions have run; if `lane` is given, only those of this lane.

        Raises:
            ReceiveTimeout: not all of these actions have run after `timeout` [s].
        """

        def is_empty() -> bool:
            return not self._threads if lane is None else lane not in self._threads

        with self._changed:
            if not self._changed.wait_for(is_empty, timeout):
                pending = self.pending if lane is None else len(self._lanes.get(lane, ())) + 1
                raise ReceiveTimeout(f"messages were not sent within {timeout:g} s; pending: {pending}")

    def close(self) -> None:
        """Let waiting actions run for up to two seconds, then drop the remaining ones; may be called twice."""
        with self._changed:
            self._closed = True
            threads = list(self._threads.values())
        join(*threads)
        self._abandoned = True

    def _on_failure(self, lane: str, failure: Failure) -> None:
        """If the thread of a lane has failed for good, clear the lane; the next action starts a new thread."""
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
                # Failures after the session or this outbox was closed are expected: logged as INFO, but
                # counted as failed.
                is_expected = self._closed or isinstance(failure, SessionClosed)
                logger.log(logging.INFO if is_expected else logging.ERROR, "sending on %s failed: %s", key, failure)
            with self._changed:
                self.longest = max(self.longest, time.monotonic() - start)
                self.sent += not error
                self.failed += bool(error)
                self.last_error = error or self.last_error
