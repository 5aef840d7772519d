"""Thread that runs queued tasks; the queue is limited in bytes, and queueing never blocks."""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable

from transport.supervision import supervised

logger = logging.getLogger(__name__)


class WriterThread:
    """Runs tasks one after the other, in the order of their arrival, until it is closed."""

    def __init__(self, name: str, limit: int) -> None:
        """Start.

        Args:
            name: name of the thread.
            limit: bytes that waiting tasks may hold together; tasks that hold none are always taken.
        """
        self._limit = limit
        self._changed = threading.Condition()
        self._tasks: deque[tuple[int, Callable[[], None]]] = deque()
        self._waiting = 0
        self._is_busy = self._is_closing = False
        self._thread = supervised(name, self._run)
        self._thread.start()

    @property
    def waiting(self) -> int:
        """Bytes of the waiting tasks."""
        with self._changed:
            return self._waiting

    def post(self, size: int, task: Callable[[], None]) -> bool:
        """Queue a task that holds `size` bytes of memory; False if the queue is full or closed."""
        with self._changed:
            if self._is_closing or (size and self._waiting + size > self._limit):
                return False
            self._tasks.append((size, task))
            self._waiting += size
            self._changed.notify_all()
            return True

    def flush(self, timeout: float) -> bool:
        """Wait until all tasks are done; False after `timeout` [s]."""
        with self._changed:
            return self._changed.wait_for(lambda: not self._tasks and not self._is_busy, timeout)

    def close(self, timeout: float) -> bool:
        """Accept no more tasks and end when all are done; False after `timeout` [s], when the thread still runs."""
        is_done = self.flush(timeout)
        with self._changed:
            self._is_closing = True
            self._changed.notify_all()
        if is_done:
            self._thread.join()
        return is_done

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._tasks or self._is_closing)
                if not self._tasks:
                    return
                size, task = self._tasks.popleft()
                self._is_busy = True
            try:
                task()
            except Exception:
                logger.exception("writing failed")
            finally:
                with self._changed:
                    self._waiting -= size
                    self._is_busy = False
                    self._changed.notify_all()
