"""Zenoh liveliness tokens: declared by a node, and monitored by its clients."""

from __future__ import annotations

import threading
from collections.abc import Callable

from transport import zenoh_api
from transport.links.session import Resource, Session


def alive_keys(session: Session, keys: str, timeout: float = 1.0) -> list[str]:
    """Return the keys of the live tokens that match `keys`, a key expression; waits up to `timeout` [s] for replies."""
    found: list[str] = session.attempt(f"cannot look for {keys!r}", zenoh_api.tokens, session.raw, keys, timeout)
    return found


class AliveToken(Resource):
    """Liveliness token of a session; for others, it disappears when it or the session is closed or the link is lost."""

    def __init__(self, session: Session, key: str) -> None:
        """Declare the token on `key`, such as `keys.alive_key(robot)`."""
        self.key = key
        self._raw = session.attempt(f"cannot declare {key!r}", zenoh_api.declare_token, session.raw, key)
        super().__init__(session)


class TokenWatcher(Resource):
    """Monitor of all liveliness tokens that match a key expression.

    Attributes:
        names: last chunks of the keys of the live tokens.
    """

    def __init__(self, session: Session, keys: str, on_change: Callable[[frozenset[str]], None]) -> None:
        """Start to monitor `keys`, a key expression; `on_change(names)` runs on Zenoh's thread and must not block."""
        self._lock = threading.Lock()
        self.names: frozenset[str] = frozenset()
        self._on_change = on_change
        what = f"cannot watch {keys!r}"
        self._raw = session.attempt(what, zenoh_api.watch_tokens, session.raw, keys, self._on_token)
        super().__init__(session)

    def _on_token(self, key: str, alive: bool) -> None:
        name = key.rpartition("/")[2]
        with self._lock:
            self.names = names = self.names | {name} if alive else self.names - {name}
        self._on_change(names)


class AliveWatcher(TokenWatcher):
    """Monitor of the liveliness token on one key.

    Attributes:
        was_seen: True if the token has been alive at least once.
    """

    def __init__(self, session: Session, key: str, on_change: Callable[[bool], None] = lambda is_alive: None) -> None:
        """Start to monitor `key`; `on_change(is_alive)` runs on Zenoh's thread and must not block."""
        self._changed = threading.Condition()
        self.was_seen = False
        self._on_alive = on_change
        super().__init__(session, key, self._note)

    @property
    def is_alive(self) -> bool:
        """True while the token is alive."""
        return bool(self.names)

    def wait(self, alive: bool, timeout: float) -> bool:
        """Wait until `is_alive` equals `alive`; return False if it does not within `timeout` [s].

        Closing ends the wait.
        """
        with self._changed:
            self._changed.wait_for(lambda: self.is_alive == alive or self.is_closed, timeout)
            return self.is_alive == alive

    def _note(self, names: frozenset[str]) -> None:
        with self._changed:
            self.was_seen |= bool(names)
            self._changed.notify_all()
        self._on_alive(bool(names))

    def _release(self) -> None:
        with self._changed:
            self._changed.notify_all()
        super()._release()
