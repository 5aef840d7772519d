"""Log lines: JSON, priorities for journald, and the rate limit; also of a node in its own process."""

import json
import logging
import os
import subprocess
import sys
import time

import pytest

from guara_perception.app import logs
from guara_perception.app.logs import MOST, JournalFormatter, JsonFormatter, RateLimit


def record(level: int, message: str, *arguments: object, error: bool = False) -> logging.LogRecord:
    try:
        raise ValueError("a wrong value")
    except ValueError:
        info = sys.exc_info() if error else None
    return logging.LogRecord("guara.node", level, __file__, 1, message, arguments, info)


def test_a_record_is_one_json_object() -> None:
    """With time, level, name and message, and a traceback if there is one; line breaks are escaped."""
    line = JsonFormatter().format(record(logging.ERROR, "step %d: no scan,\n%s", 3, "Guará", error=True))
    assert "\n" not in line
    told = json.loads(line)
    assert (told["level"], told["name"], told["message"]) == ("ERROR", "guara.node", "step 3: no scan,\nGuará")
    assert told["time"].endswith("+00:00") and "ValueError: a wrong value" in told["traceback"]


def test_each_line_for_the_journal_has_its_priority() -> None:
    """Those of sd-daemon(3), also for the second line of a message."""
    formatter = JournalFormatter(logs.TEXT)
    assert formatter.format(record(logging.WARNING, "one\ntwo")) == "<4>WARNING guara.node: one\n<4>two"
    assert formatter.format(record(logging.ERROR, "three")).startswith("<3>")


def test_a_repeated_message_is_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first record after a minute reports how many were dropped; other messages are not affected."""
    now = 100.0
    monkeypatch.setattr(time, "monotonic", lambda: now)
    limit = RateLimit()
    passed = sum(limit.filter(record(logging.WARNING, "lost %d", number)) for number in range(MOST + 7))
    assert passed == MOST and limit.filter(record(logging.ERROR, "lost %d", 0))
    now += logs.WITHIN_S + 1.0
    after = record(logging.WARNING, "lost %d", 99)
    assert limit.filter(after) and after.getMessage() == f"lost 99 (7 more within {logs.WITHIN_S:.0f} s)"
    now += logs.WITHIN_S + 1.0
    assert limit.filter(quiet := record(logging.WARNING, "lost %d", 1)) and quiet.getMessage() == "lost 1"


def test_a_node_logs_json() -> None:
    """Each printed line is an object, including the line of a scan."""
    command = [sys.executable, "-m", "guara_perception.app.main", "-v", "run", "--simulated", "--log", "json"]
    command += ["--listen", "tcp/127.0.0.1:0"]
    lines: list[str] = []
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as node:
        assert node.stdout is not None and node.stderr is not None
        try:
            for line in node.stdout:
                lines.append(line)
                if "known" in line:
                    node.terminate()
            node.wait(60)
            lines += node.stderr.readlines()
        finally:
            node.kill()
    told = [json.loads(line) for line in lines]
    assert node.returncode == 0
    messages = [each["message"] for each in told]
    assert any("listening on" in message for message in messages) and "stopped, laser off" in messages
    assert any(message.startswith("guara-perception 0.") for message in messages)
    assert all(each["level"] in ("INFO", "WARNING", "ERROR") for each in told)


def test_standard_error_that_is_the_journal_gets_priorities() -> None:
    """$JOURNAL_STREAM contains device and inode of standard error."""
    program = (
        "import os, sys, logging; status = os.fstat(2)\n"
        "if sys.argv[1] == 'journal': os.environ['JOURNAL_STREAM'] = f'{status.st_dev}:{status.st_ino}'\n"
        "from guara_perception.app.logs import log_to_stderr\n"
        "log_to_stderr(); log_to_stderr(); logging.getLogger('guara').error('no board')"
    )
    environment = {name: value for name, value in os.environ.items() if name != "JOURNAL_STREAM"}
    printed = {
        where: subprocess.run(
            [sys.executable, "-c", program, where],
            capture_output=True,
            text=True,
            timeout=60,
            env=environment,
            check=True,
        ).stderr
        for where in ("journal", "terminal")
    }
    assert printed == {"journal": "<3>ERROR guara: no board\n", "terminal": "ERROR guara: no board\n"}
