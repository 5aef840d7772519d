"""Periodic messages of a session, sent together on one thread."""

from __future__ import annotations

import threading
from collections.abc import Callable

from transport.supervision import join, report, supervised

# Period of the messages [s].
PERIOD = 0.5


class Pulse:
    """Thread that calls all added actions once per period, from the first `add` until `close`.

    Every message wakes the sender, the router and the reader; messages that are sent together wake each of them once.
    """

    def __init__(self) -> None:
        """Start without actions and without a thread."""
        self._lock = threading.Lock()
        self._actions: dict[object, Callable[[], None]] = {}
        self._closing = threading.Event()
        self._thread: threading.Thread | None = None

    def add(self, owner: object, action: Callable[[], None], *, first: bool = False) -> None:
        """Call `action` once per period until `remove(owner)` or `close`.

        Args:
            owner: object that identifies the action for `remove`; an owner has at most one action.
            action: function that sends a small message; must return quickly.
            first: True = call this action before the existing ones.
        """
        with self._lock:
            self._actions = {owner: action, **self._actions} if first else {**self._actions, owner: action}
            if self._thread is None and not self._closing.is_set():
                self._thread = supervised("transport-pulse", self._run)
                self._thread.start()

    def remove(self, owner: object) -> None:
        """Remove the action of `owner`; the current round may still call it. May be called twice."""
        with self._lock:
            self._actions = {other: action for other, action in self._actions.items() if other is not owner}

    def close(self) -> None:
        """Stop calling the actions; may be called twice."""
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
                    report(f"periodic action {action.__qualname__}", error)
