"""Progress bar: shown at a terminal, not for a file or a pipe."""

import os
import pty
import subprocess
import sys

import pytest

from guara_perception.app.progress import progress

SCRIPT = """
from guara_perception.app.progress import progress
with progress("Counting sheep") as show:
    for number in range(3):
        show(number + 1, 3)
print("done")
"""


def test_nothing_is_shown_without_a_terminal(capfd):
    """Standard output and standard error stay empty, whatever is reported."""
    with progress("Counting") as show:
        show(1, 5)
        show(5, 5)
    assert capfd.readouterr() == ("", "")


def test_a_pipe_gets_the_output_only():
    """A command whose output is piped prints its results without a bar."""
    done = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("done\n", "")


@pytest.mark.slow
def test_a_terminal_gets_a_bar():
    """At a terminal, the description appears, and the bar is removed at the end."""
    reading_end, program_end = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, "-c", SCRIPT],
        stdout=program_end,
        stderr=program_end,
        env={**os.environ, "TERM": "xterm", "COLUMNS": "100"},
    )
    os.close(program_end)
    shown = b""
    while True:
        try:
            received = os.read(reading_end, 4096)
        except OSError:  # so Linux reports that the last writer has gone
            break
        if not received:
            break
        shown += received
    os.close(reading_end)
    assert process.wait(60) == 0
    assert b"Counting sheep" in shown and b"done" in shown
