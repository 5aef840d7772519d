"""End of a program: wait for Ctrl-C or SIGTERM, and close the devices within a bounded time."""

from __future__ import annotations

import faulthandler
import os
import queue
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from types import FrameType
from typing import Any

import click

from guara_perception.app.exit_codes import EXIT_FAILED
from transport.supervision import supervised

# A signal delivered to another thread is handled within this time [s].
WAKE_PERIOD = 0.5
# [s] Time for closing devices: a driver takes a few seconds to give up on a disconnected camera.
CLOSE_TIMEOUT_S = 30.0


class StopEvent(threading.Event):
    """Event whose unbounded wait wakes periodically.

    The system may deliver a signal to any thread, but only the main thread runs Python's handlers, and only while it is
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
    """Yield an event that SIGINT and SIGTERM set while the block runs; previous handlers are restored afterwards."""
    stop = StopEvent()
    # A handler runs in the main thread, which may hold the event's lock at that moment, so it must not set the event.
    # It puts an item into this queue, and another thread sets the event.
    signals: queue.SimpleQueue[bool] = queue.SimpleQueue()

    def handle(number: int, stack: FrameType | None) -> None:
        signals.put(True)

    def pass_on() -> None:
        while signals.get():
            stop.set()

    listener = supervised("guara-stop", pass_on)
    listener.start()
    before = {number: signal.signal(number, handle) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        signals.put(False)
        listener.join()


@contextmanager
def closed_within(devices: AbstractContextManager[Any], seconds: float | None = None) -> Iterator[None]:
    """Open `devices` and close them at the end of the block; end the process with code 1 if closing takes too long.

    Enter this before contexts that must close in an orderly way, such as a recording: those are then closed first.

    Args:
        devices: board and camera.
        seconds: longest time for closing them [s]; None = CLOSE_TIMEOUT_S.
    """
    seconds = CLOSE_TIMEOUT_S if seconds is None else seconds
    with ExitStack() as stack:
        alarm = threading.Timer(seconds, _end, [seconds])
        alarm.daemon = True
        stack.callback(faulthandler.cancel_dump_traceback_later)
        stack.callback(alarm.cancel)
        stack.enter_context(devices)
        # A driver may hang while it holds the GIL: no Python thread runs then, but faulthandler's own thread does.
        stack.callback(faulthandler.dump_traceback_later, 2.0 * seconds, exit=True, file=sys.__stderr__ or 2)
        stack.callback(alarm.start)
        yield


def _end(seconds: float) -> None:
    try:
        click.echo(
            f"guara: camera or laser board did not close within {seconds:g} s; exiting anyway. The board's watchdog "
            "turns the laser off: check that the laser is off, then unplug and reconnect camera and board",
            err=True,
        )
    finally:
        os._exit(EXIT_FAILED)
