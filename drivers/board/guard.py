"""Closing of open boards at the end of the program, so that their lasers are off.

An exception unwinds `with` blocks; SIGTERM and SIGHUP end the program without doing so. While a board is open, these
signals are therefore converted to `SystemExit`, unless the program handles or ignores them, opened the board outside
the main thread, or switched this off (`BoardConfig.handle_signals`). A board opened without a `with` block is closed at
interpreter exit. After SIGKILL, which cannot be caught, the board's watchdog turns the laser off.
"""

from __future__ import annotations

import atexit
import logging
import signal
import threading
from types import FrameType
from typing import Protocol

logger = logging.getLogger(__name__)
SIGNALS = tuple(getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name))


class Closable(Protocol):
    """Object whose `close()` may be called twice."""

    def close(self) -> None:
        """Turn the laser off and close the object."""


_open: list[Closable] = []
_taken: list[int] = []
_lock = threading.RLock()


def watch(device: Closable, handle_signals: bool = True) -> None:
    """Close `device` at the end of the program, unless `release` is called first.

    Args:
        device: open device.
        handle_signals: True = convert the signals whose action is the default, if called from the main thread.
    """
    with _lock:
        if device in _open:
            return
        if not _open:
            atexit.register(_close_all)
        _open.append(device)
        if handle_signals and threading.current_thread() is threading.main_thread():
            for number in SIGNALS:
                if signal.getsignal(number) is signal.SIG_DFL:
                    signal.signal(number, _leave)
                    _taken.append(number)


def release(device: Closable) -> None:
    """Forget `device`. If none is left and this is the main thread, restore the default actions of the signals."""
    with _lock:
        if device in _open:
            _open.remove(device)
        if _open:
            return
        atexit.unregister(_close_all)
        if threading.current_thread() is threading.main_thread():
            while _taken:
                number = _taken.pop()
                if signal.getsignal(number) is _leave:
                    signal.signal(number, signal.SIG_DFL)


def _leave(number: int, frame: FrameType | None) -> None:
    raise SystemExit(128 + number)


def _close_all() -> None:
    for device in list(_open):
        try:
            device.close()
        except Exception:
            logger.exception("a laser board could not be closed at exit; its watchdog turns the laser off")
