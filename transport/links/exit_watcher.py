"""Closing of open sessions when the main thread ends, so that Zenoh does not keep a failed script alive.

An open session with a subscriber prevents the interpreter from exiting, and `atexit` functions run too late. Therefore,
one thread of the process joins the main thread and then closes the sessions.
"""

from __future__ import annotations

import logging
import threading
from typing import Protocol

from transport.supervision import supervised

logger = logging.getLogger(__name__)
_lock = threading.Lock()
_open: set[Closable] = set()
_watcher: threading.Thread | None = None


class Closable(Protocol):
    """Object whose `close()` may be called twice."""

    def close(self) -> None:
        """Release all resources."""


def watch(resource: Closable) -> None:
    """Close `resource` when the main thread ends, unless `forget` is called first."""
    global _watcher
    with _lock:
        _open.add(resource)
        if _watcher is None or not _watcher.is_alive():
            # Not a daemon, because the interpreter must wait until the sessions are closed.
            _watcher = supervised("transport-exit-watcher", _run, daemon=False)
            _watcher.start()


def forget(resource: Closable) -> None:
    """Cancel `watch(resource)`; does nothing if the resource is not watched."""
    with _lock:
        _open.discard(resource)


def _run() -> None:
    global _watcher
    threading.main_thread().join()
    with _lock:
        left = list(_open)
        _open.clear()
        _watcher = None
    for resource in left:
        try:
            resource.close()
        except Exception:
            logger.exception("closing %r at the end of the program failed", resource)
