"""Periodic messages of a session, sent together from one thread."""

from __future__ import annotations

import threading
from collections.abc import Callable

from transport.supervision import join, report, supervised

# Period [s].
PERIOD = 0.5


class Pulse:
    """Calls all added actions periodically, on a thread that runs from the first action until `close`.

    Every message wakes the sender, the router and the reader; messages sent together wake each of them once.
    """

    def __init__(self) -> None:
        """Start without actions and without a thread."""
        self._lock = threading.Lock()
        self._actions: dict[object, Callable[[], None]] = {}
        self._closing = threading.Event()
        self._thread: threading.Thread | None = None

    def add(self, owner: object, action: Callable[[], None], *, first: bool = False) -> None:
        """Call `action` in each period from now on, until `owner` is removed.

        Args:
            owner: object that the action belongs to; a second action of the same owner replaces the first.
            action: function that sends a small message; must be quick.
            first: call it before the existing actions.
        """
        with self._lock:
            self._actions = {owner: action, **self._actions} if first else {**self._actions, owner: action}
            if self._thread is None and not self._closing.is_set():
                self._thread = supervised("transport-pulse", self._run)
                self._thread.start()

    def remove(self, owner: object) -> None:
        """Remove the action of `owner`; a call in progress is not interrupted. Safe to call twice."""
        with self._lock:
            self._actions = {other: action for other, action in self._actions.items() if other is not owner}

    def close(self) -> None:
        """Stop; safe to call twice."""
        self._closing.set()
        join(self._thread)

    def _run(self) -> None:
        while not self._closing.wait(PERIOD):
            with self._lock:
                actions = list(self._actions.values())
            for action in actions:
                try:
                    action()
                except Exception as error:
                    report(f"beat {action.__qualname__}", error)
