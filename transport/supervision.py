"""Supervised threads and callbacks: failures are logged and reported, and threads are restarted."""

from __future__ import annotations

import functools
import logging
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from transport.messages.status_message import StatusItem
from transport.messages.terrain_message import Health

logger = logging.getLogger(__name__)
# Largest number of restarts of a thread within a period, and length of that period [s]; a further failure is final.
RESTARTS = 3
RESTART_PERIOD = 60.0
# Delay before a restart [s]; it keeps a short disturbance from using up all restarts.
RESTART_DELAY = 0.1
# Time for which a failure that is not final is an error in the status [s]; afterwards it is a warning. A final failure
# remains an error.
ERROR_TIME = 60.0
# Name of the status item.
THREADS_NAME = "threads"
# Longest wait for threads that have been told to end [s].
CLOSE_TIMEOUT = 2.0
# Shortest time between two log lines of the same kind [s].
LOG_PERIOD = 10.0


class Seldom:
    """Rate-limited logging: the first line at once, then at most one per period, with the number of omitted lines."""

    def __init__(self, target: logging.Logger, level: int = logging.WARNING, period: float = LOG_PERIOD) -> None:
        """Write to the logger `target`; `period` is in [s]."""
        self._target, self._level, self._period = target, level, period
        self._lock = threading.Lock()
        self._next = 0.0
        self._held_back = 0

    def log(self, text: str, *values: object) -> None:
        """Log a line, or count it as omitted; arguments as in `logging.Logger.log`, without the level."""
        now = time.monotonic()
        with self._lock:
            if now < self._next:
                self._held_back += 1
                return
            self._next, held_back, self._held_back = now + self._period, self._held_back, 0
        if held_back:
            text += f" ({held_back} similar lines omitted in the last {self._period:g} s or longer)"
        self._target.log(self._level, text, *values)


@dataclass(frozen=True, slots=True)
class Failure:
    """Failure of a thread or of a callback.

    Attributes:
        part: name of the thread or callback.
        error: type and text of the exception.
        is_final: True if a thread has used up its restarts and will not run again.
        at: time of the failure on the monotonic clock [s].
        continues: True unless a single task failed, which is not restarted; ignored if `is_final`.
    """

    part: str
    error: str
    is_final: bool
    at: float
    continues: bool = True

    def __str__(self) -> str:
        """Describe the failure."""
        end = " for good" if self.is_final else " and continues" if self.continues else ""
        return f"{self.part} failed{end}: {self.error}"


Follower = Callable[[Failure], None]
_lock = threading.Lock()
_followers: list[Follower] = []
_lines: dict[str, Seldom] = {}


def follow(take: Follower) -> None:
    """Call `take` with each failure in this process, on the failed thread, until `forget(take)`."""
    with _lock:
        _followers.append(take)


def forget(take: Follower) -> None:
    """Stop calling `take`; may be called twice."""
    with _lock:
        if take in _followers:
            _followers.remove(take)


def report(part: str, error: BaseException, *, is_final: bool = False, continues: bool = True) -> Failure:
    """Pass a failure to all followers, and log it; the log of repeated failures of a part is rate-limited."""
    failure = Failure(part, f"{type(error).__name__}: {error}", is_final, time.monotonic(), continues)
    with _lock:
        followers = list(_followers)
        line = _lines.setdefault(part, Seldom(logger, logging.ERROR))
    for take in followers:
        try:
            take(failure)
        except Exception:
            logger.exception("reporting a failure failed")
    write = logger.critical if is_final else line.log
    write("%s\n%s", failure, "".join(traceback.format_exception(error)).rstrip())
    return failure


def supervised(
    name: str,
    target: Callable[[], Any],
    *,
    restarts: int | None = RESTARTS,
    on_failure: Follower | None = None,
    daemon: bool = True,
) -> threading.Thread:
    """Create, but do not start, a thread whose failures are reported. All threads of this package are created here.

    Args:
        name: name of the thread.
        target: main function of the thread; called again after an exception.
        restarts: number of restarts allowed within `RESTART_PERIOD`. None = a single task, which is not restarted and
            whose failure is not final.
        on_failure: called with each failure, for cleaning up.
        daemon: as in `threading.Thread`.
    """

    def run() -> None:
        times: deque[float] = deque(maxlen=(restarts or 0) + 1)
        while True:
            try:
                target()
            except BaseException as error:  # SystemExit would also end the thread silently
                times.append(time.monotonic())
                is_final = restarts is not None and len(times) > restarts and times[-1] - times[0] < RESTART_PERIOD
                failure = report(name, error, is_final=is_final, continues=restarts is not None)
                if on_failure is not None:
                    on_failure(failure)
                if is_final or restarts is None:
                    return
                time.sleep(RESTART_DELAY)
            else:
                return

    return threading.Thread(target=run, name=name, daemon=daemon)


def join(*threads: threading.Thread | None) -> None:
    """Wait for threads to end, at most `CLOSE_TIMEOUT` for all; the calling thread and None are skipped."""
    deadline = time.monotonic() + CLOSE_TIMEOUT
    for thread in threads:
        if thread is not None and thread is not threading.current_thread():
            thread.join(max(0.0, deadline - time.monotonic()))


def guarded(callback: Callable[..., None]) -> Callable[..., None]:
    """Wrap a callback that Zenoh calls: its exceptions are reported and do not propagate."""
    name = f"callback {getattr(callback, '__qualname__', repr(callback))}"

    @functools.wraps(callback)
    def call(*arguments: Any) -> None:
        try:
            callback(*arguments)
        except BaseException as error:  # Zenoh would only write it to stderr
            report(name, error)

    return call


class FailureLog:
    """Failures of this process since the log was created, as a status item."""

    def __init__(self, on_change: Callable[[], None]) -> None:
        """Follow failures until `close`; `on_change` is called after each failure, on the failed thread."""
        self._on_change = on_change
        self._last: dict[str, Failure] = {}
        self._count = 0
        follow(self._take)

    def close(self) -> None:
        """Stop following failures; may be called twice."""
        forget(self._take)

    def _take(self, failure: Failure) -> None:
        self._count += 1
        self._last = {**self._last, failure.part: failure}
        self._on_change()

    def items(self) -> list[StatusItem]:
        """Return one status item that names all failed parts, or none if nothing has failed."""
        failures = list(self._last.values())
        if not failures:
            return []
        now = time.monotonic()
        recent = [failure for failure in failures if failure.is_final or now - failure.at < ERROR_TIME]
        return [
            StatusItem(
                name=THREADS_NAME,
                level=Health.ERROR if recent else Health.WARN,
                message="; ".join(map(str, recent or failures)),
                values={"failures": str(self._count), "parts": ", ".join(self._last)},
            )
        ]
