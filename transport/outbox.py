"""A thread that publishes for others: one slot per key, so that no receiver can ever delay who produces."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable

from transport.exceptions import ReceiveTimeout, SessionClosed

logger = logging.getLogger(__name__)
# Questions that may wait for an answer; more are dropped, so that a flood of them fills no memory.
MAXIMUM_PENDING = 64

# [s] How long closing waits for a message that is being sent.
CLOSE_TIMEOUT = 2.0


class Outbox:
    """Runs one pending action per key, oldest first, on its own thread.

    An action that waits when a newer one of the same key comes is replaced by it and counted.
    """

    def __init__(self) -> None:
        """Start the thread."""
        self._changed = threading.Condition()
        self._pending: dict[str, Callable[[], None]] = {}
        self._busy = False
        self._closed = False
        self._sent = 0
        self._superseded = 0
        self._failed = 0
        self._last_error = ""
        self._longest = 0.0
        # A daemon: a put that a broken link holds must not keep the interpreter; close() joins it.
        self._thread = threading.Thread(target=self._run, name="transport-outbox", daemon=True)
        self._thread.start()

    @property
    def sent(self) -> int:
        """Actions that were run without error."""
        return self._sent

    @property
    def pending(self) -> int:
        """Actions that wait."""
        return len(self._pending)

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

    def post(self, key: str, action: Callable[[], None]) -> None:
        """Hand over an action; returns at once.

        Args:
            key: slot; a waiting action of the same key is dropped.
            action: encodes and sends.

        Raises:
            SessionClosed: the outbox is closed.
        """
        with self._changed:
            if self._closed:
                raise SessionClosed(f"cannot send on {key!r}: the outbox is closed")
            if self._pending.pop(key, None) is not None:
                self._superseded += 1
            self._pending[key] = action
            self._changed.notify_all()

    def flush(self, timeout: float) -> None:
        """Wait until all that was posted has been sent.

        Raises:
            ReceiveTimeout: it took longer than `timeout` [s].
        """
        with self._changed:
            if not self._changed.wait_for(lambda: not self._pending and not self._busy, timeout):
                raise ReceiveTimeout(f"{len(self._pending)} messages were not sent within {timeout:g} s")

    def close(self) -> None:
        """Send what waits, as far as that is quick, and end the thread; safe to call twice."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        if self._thread is not threading.current_thread():
            self._thread.join(CLOSE_TIMEOUT)

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._pending or self._closed)
                if not self._pending:
                    return
                key = next(iter(self._pending))
                action = self._pending.pop(key)
                self._busy = True
            start = time.monotonic()
            try:
                action()
                self._sent += 1
            except Exception as error:
                self._failed += 1
                self._last_error = f"{key}: {error}"
                logger.error("sending on %s failed: %s", key, error)
            with self._changed:
                self._longest = max(self._longest, time.monotonic() - start)
                self._busy = False
                self._changed.notify_all()
