"""Closes devices within a time, whatever they do: a driver that hangs ends with the process."""

from __future__ import annotations

import faulthandler
import os
import sys
import threading
from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from typing import Any

import click

from guara_perception.app.exit_codes import EXIT_FAILED

# [s] A camera that is gone takes some seconds to be given up; the recording is closed before.
CLOSE_TIMEOUT_S = 30.0


@contextmanager
def closed_within(devices: AbstractContextManager[Any], seconds: float | None = None) -> Iterator[None]:
    """Open `devices`, and close them at the end of the block; when that takes longer, end the process with code 1.

    Enter this before whatever must be closed in an orderly way, such as a recording: that is then closed first.

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
        stack.callback(_arm, alarm, seconds)
        yield


def _arm(alarm: threading.Timer, seconds: float) -> None:
    alarm.start()
    # A driver may hang while it holds Python's lock: then no Python thread runs any more, but faulthandler's own does.
    faulthandler.dump_traceback_later(2.0 * seconds, exit=True, file=sys.__stderr__ or 2)


def _end(seconds: float) -> None:
    try:
        click.echo(
            f"guara: camera or laser board did not close within {seconds:g} s, ended without them; the board's "
            "watchdog puts the laser out: see that it is dark, then plug both in again",
            err=True,
        )
    finally:
        os._exit(EXIT_FAILED)
