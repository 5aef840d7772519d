"""Closes what is still open when the main thread ends, so that no script that crashed is kept alive by Zenoh.

An open session with a subscriber keeps the interpreter waiting for ever, and `atexit` functions run too late
to help. One thread for the whole process watches the main thread and is gone when nothing is open.
"""

import logging
import threading
from typing import Final, Protocol

_LOG = logging.getLogger(__name__)
_PERIOD: Final = 0.5
"""[s] How soon after the main thread's end the sessions are closed; each look costs a tenth of a millisecond."""

_changed = threading.Condition()
_open: "set[Closable]" = set()
_watcher: threading.Thread | None = None


class Closable(Protocol):
    """Anything with `close()`, which must be safe to call twice."""

    def close(self) -> None:
        """Release all that is held."""


def watch(resource: Closable) -> None:
    """Close `resource` when the main thread ends, unless `forget` is called before."""
    global _watcher
    with _changed:
        _open.add(resource)
        if _watcher is None or not _watcher.is_alive():
            # Not a daemon: the interpreter must wait for it, and so for the sessions to be closed.
            _watcher = threading.Thread(target=_run, name="transport-exit-watcher", daemon=False)
            _watcher.start()


def forget(resource: Closable) -> None:
    """Stop watching `resource`; the thread ends with the last one."""
    with _changed:
        _open.discard(resource)
        _changed.notify_all()


def _run() -> None:
    global _watcher
    main = threading.main_thread()
    with _changed:
        while _open and main.is_alive():
            _changed.wait(_PERIOD)
        left = list(_open)
        _open.clear()
        _watcher = None
    for resource in left:
        try:
            resource.close()
        except Exception:
            _LOG.exception("closing %r at the end of the program failed", resource)
