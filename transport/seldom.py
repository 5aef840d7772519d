"""Log lines that come seldom: of a flood of bad messages the first is written, the others are counted."""

from __future__ import annotations

import logging
import threading
import time

# [s] Between two lines of one kind.
PERIOD = 10.0


class Seldom:
    """Writes the first line of a kind at once, and after that one in `PERIOD` with the number that it stands for."""

    def __init__(self, log: logging.Logger, level: int = logging.WARNING, period: float = PERIOD) -> None:
        """Write to `log`."""
        self._log, self._level, self._period = log, level, period
        self._lock = threading.Lock()
        self._next = 0.0
        self._held_back = 0

    def say(self, text: str, *values: object) -> None:
        """Write a line, or count it; arguments as in `logging.Logger.log`."""
        now = time.monotonic()
        with self._lock:
            if now < self._next:
                self._held_back += 1
                return
            self._next, held_back, self._held_back = now + self._period, self._held_back, 0
        if held_back:
            text += f" ({held_back} more like this in the last {self._period:g} s or longer)"
        self._log.log(self._level, text, *values)
