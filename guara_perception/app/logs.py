"""Logging for the command-line tools, as text or JSON, with priorities for journald and a rate limit."""

from __future__ import annotations

import json
import logging
import os
import sys
import time
from datetime import UTC, datetime
from typing import Any, TextIO

STYLES = ("text", "json")
TEXT = "%(levelname)s %(name)s: %(message)s"
# Largest number of records of one message within WITHIN_S [s]; further records are counted instead of logged.
MOST, WITHIN_S = 10, 60.0
# Largest number of distinct messages that are tracked. Messages that are formatted before logging are all distinct and
# would accumulate for months.
MOST_MESSAGES = 1000
# syslog(3) priority of each level, the prefix of text lines sent to journald (sd-daemon(3)).
PRIORITIES = {logging.DEBUG: 7, logging.INFO: 6, logging.WARNING: 4, logging.ERROR: 3, logging.CRITICAL: 2}


def json_line(level: str, name: str, message: str, **more: Any) -> str:
    """Return a log line as a JSON object with the UTC time, level ("INFO", "ERROR", ...), name and message."""
    when = datetime.now(UTC).isoformat(timespec="milliseconds")
    return json.dumps({"time": when, "level": level, "name": name, "message": message, **more}, ensure_ascii=False)


class JsonFormatter(logging.Formatter):
    """Formatter that converts records to JSON lines (`json_line`), with the traceback if there is one."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the JSON line of a record."""
        more = {} if record.exc_info is None else {"traceback": self.formatException(record.exc_info)}
        return json_line(record.levelname, record.name, record.getMessage(), **more)


class JournalFormatter(logging.Formatter):
    """Formatter for journald, which prefixes each line with the priority of its record."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the prefixed lines of a record."""
        priority = f"<{PRIORITIES.get(record.levelno, 6)}>"
        return "\n".join(priority + line for line in super().format(record).splitlines())


class RateLimit(logging.Filter):
    """Filter that passes at most MOST records of one message within WITHIN_S.

    The next record of that message that passes reports how many were dropped.
    """

    def __init__(self) -> None:
        """Start without any record."""
        super().__init__()
        self._windows: dict[tuple[str, int, str], list[float]] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        """Return False to drop a record."""
        now, key = time.monotonic(), (record.name, record.levelno, str(record.msg))
        if len(self._windows) >= MOST_MESSAGES:
            self._windows.clear()
        window = self._windows.setdefault(key, [now, 0.0])
        begun, count = window
        left_out = int(count) - MOST
        if now - begun > WITHIN_S:
            window[:] = now, 1.0
            if left_out > 0:
                record.msg, record.args = f"{record.getMessage()} ({left_out} more within {WITHIN_S:.0f} s)", ()
            return True
        window[1] = count + 1
        return count < MOST


class StderrHandler(logging.StreamHandler[TextIO]):
    """Handler installed by `log_to_stderr`; its class distinguishes it from handlers of the calling program."""


def log_to_stderr(style: str = "text") -> None:
    """Log to standard error, with a handler that replaces that of an earlier call.

    No handler is added if the calling program has installed one.

    Args:
        style: one of STYLES. Text lines have priorities if standard error is connected to journald.
    """
    root = logging.getLogger()
    for before in [handler for handler in root.handlers if isinstance(handler, StderrHandler)]:
        root.removeHandler(before)
    if root.handlers:
        return
    handler = StderrHandler(sys.stderr)
    as_text = (JournalFormatter if _is_journal() else logging.Formatter)(TEXT)
    handler.setFormatter(JsonFormatter() if style == "json" else as_text)
    handler.addFilter(RateLimit())
    root.addHandler(handler)


def _is_journal() -> bool:
    """True if standard error is connected to journald: systemd then sets $JOURNAL_STREAM to its device and inode."""
    try:
        status = os.fstat(sys.stderr.fileno())
    except (OSError, ValueError):
        return False
    return os.environ.get("JOURNAL_STREAM") == f"{status.st_dev}:{status.st_ino}"
