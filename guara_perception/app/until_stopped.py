"""Waits for Ctrl-C or SIGTERM, so that the program can end in an orderly way."""

from __future__ import annotations

import queue
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from transport.supervision import supervised

# A signal that the system gave to another thread is seen within this time [s].
WAKE_PERIOD = 0.5


class StopEvent(threading.Event):
    """An event whose endless wait wakes now and then.

    The system may give a signal to any thread, but only the main thread runs Python's handlers, and only while it is
    awake.
    """

    def wait(self, timeout: float | None = None) -> bool:
        """Wait as `threading.Event` does."""
        if timeout is not None:
            return super().wait(timeout)
        while not super().wait(WAKE_PERIOD):
            pass
        return True


@contextmanager
def stop_event() -> Iterator[threading.Event]:
    """An event that SIGINT and SIGTERM set while the block runs; the previous handlers are restored afterwards."""
    stop = StopEvent()
    # A handler runs in the main thread, which may hold the event's lock just then: it must not set the event. It puts
    # into this queue, and another thread sets the event.
    heard: queue.SimpleQueue[bool] = queue.SimpleQueue()

    def handle(number: int, stack: FrameType | None) -> None:
        heard.put(True)

    def pass_on() -> None:
        while heard.get():
            stop.set()

    listener = supervised("guara-stop", pass_on)
    listener.start()
    before = {number: signal.signal(number, handle) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        heard.put(False)
        listener.join()
