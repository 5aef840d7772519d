"""Forked processes are what `python ARGUMENTS...` starts, in everything that tests of programs look at."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests import forked
from tests.forked import ForkedProcess, run_forked

pytestmark = pytest.mark.slow

SAY = "import os, sys; print(__name__, sys.argv[1:], os.environ['SAID'], os.getcwd()); sys.exit(3)"
WAIT = """
import sys, time
try:
    print("ready", flush=True)
    while True:
        time.sleep(0.05)
except KeyboardInterrupt:
    sys.exit(7)
"""


@pytest.mark.parametrize("kind", ["code", "script", "module"])
def test_they_say_and_end_as_new_ones_do(kind: str, tmp_path: Path) -> None:
    """Arguments, environment, folder, name, exit code."""
    (tmp_path / "say.py").write_text(SAY)
    arguments = {"code": ["-c", SAY], "script": [tmp_path / "say.py"], "module": ["-m", "say"]}[kind]
    environment = {**os.environ, "SAID": "yes"}
    new = subprocess.run(
        [sys.executable, *arguments, "a b", "ä"],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    done = run_forked(*arguments, "a b", "ä", environment=environment, folder=tmp_path)
    assert (
        (done.returncode, done.stdout, done.stderr) == (new.returncode, new.stdout, new.stderr) == (3, done.stdout, "")
    )
    assert done.stdout == f"__main__ ['a b', 'ä'] yes {tmp_path}\n"


def test_a_failure_is_a_traceback_and_exit_1() -> None:
    done = run_forked("-c", "1 / 0")
    assert done.returncode == 1 and done.stderr.endswith("ZeroDivisionError: division by zero\n")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_signals_reach_them(number: signal.Signals) -> None:
    """Ctrl-C is KeyboardInterrupt, the others end them."""
    process = ForkedProcess("-c", WAIT)
    try:
        assert process.stdout.readline() == "ready\n" and process.poll() is None
        process.send_signal(number)
        assert process.wait(forked.PATIENCE) == (7 if number == signal.SIGINT else -number) == process.poll()
    finally:
        process.close()


def test_they_read_their_input() -> None:
    """Their standard input ends when it is closed."""
    process = ForkedProcess("-c", "import sys; print(sys.stdin.read().upper(), end='')")
    process.stdin.write("terrain")
    assert process.communicate(forked.PATIENCE) == ("TERRAIN", "")
    process.close()


def test_multiprocessing_starts_processes_from_forked_code(root: Path) -> None:
    """Code given with `-c` is no file, which a process that is spawned would look for, and never answer."""
    code = (
        "import multiprocessing as m\n"
        "with m.get_context('spawn').Pool(1) as pool:\n"
        "    print(pool.apply_async(abs, (-3,)).get(timeout=120))\n"
    )
    assert run_forked("-c", code, folder=root).stdout == "3\n"
