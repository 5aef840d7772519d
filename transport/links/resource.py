"""The base of everything that is declared in a session: closed once, with the session at the latest."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod

from transport.links.session import Session


class Resource(ABC):
    """Something declared in a session. Subclasses say in `_release` what to do when it is closed."""

    def __init__(self, session: Session) -> None:
        """Belong to `session`, which closes it at the latest with itself."""
        self._session = session
        self._close_lock = threading.Lock()
        self._is_closed = False
        session.own(self)

    @property
    def is_closed(self) -> bool:
        """Whether `close` was called."""
        return self._is_closed

    def close(self) -> None:
        """Withdraw it; safe to call twice, from any thread, and after the session."""
        with self._close_lock:
            if self._is_closed:
                return
            self._is_closed = True
        self._session.disown(self)
        self._release()

    @abstractmethod
    def _release(self) -> None:
        """Take back what was declared; called once."""
