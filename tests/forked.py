"""Python processes that save the second for importing everything: forked from one where that is done already.

One server (`fork_server.py`) serves all workers of a run, and the workers themselves are forked by it: it has imported
the tests too. What it gives is a process of its own, with its own streams, signals and end, as `subprocess.Popen` would
start it. Tests of the interpreter's start and end, as of imports and exit, need a new interpreter.
Run as `python forked.py ARGUMENTS...` this file is `python ARGUMENTS...`, forked.
"""

from __future__ import annotations

import atexit
import json
import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import IO

SERVER = Path(__file__).with_name("fork_server.py")
ADDRESS = "TESTS_FORK_SERVER"
PATIENCE = 180.0


def start_server(*pytest_arguments: str) -> None:
    """Start the server of this process and of all that it starts; it ends with this process.

    Args:
        pytest_arguments: what it collects, for workers that run tests; without any it imports the packages only.
    """
    with socket.socket(socket.AF_UNIX) as listener:
        # The kernel finds a free name in its own name space; whoever asks early waits until all is imported.
        listener.bind("")
        listener.listen(256)
        os.environ[ADDRESS] = listener.getsockname()[1:].decode()
        command = [sys.executable, str(SERVER), str(listener.fileno()), *pytest_arguments]
        # More threads of linear algebra than workers only wait for one another; a fork would lose them.
        environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
        pipe, fds = subprocess.PIPE, [listener.fileno()]
        server = subprocess.Popen(command, env=environment, stdin=pipe, stdout=subprocess.DEVNULL, pass_fds=fds)
    # It ends when its standard input does. Waiting for it adds its processor time to that of this process.
    atexit.register(server.communicate)


def ask(
    arguments: Sequence[str], streams: Sequence[int], environment: Mapping[str, str], folder: str
) -> tuple[int, IO]:
    """A forked process of `python ARGUMENTS...` with three streams; its id, and where its status will be written."""
    if ADDRESS not in os.environ:
        start_server()
    request = json.dumps({"arguments": [*arguments], "environment": {**environment}, "folder": folder}).encode()
    connection = socket.socket(socket.AF_UNIX)
    connection.settimeout(PATIENCE)
    connection.connect("\0" + os.environ[ADDRESS])
    socket.send_fds(connection, [len(request).to_bytes(4, "big")], list(streams))
    connection.sendall(request)
    answers = connection.makefile("r")
    line = answers.readline()
    assert line, "the server of forked processes has ended"
    connection.settimeout(None)
    connection.close()  # `answers` keeps it open.
    return int(line), answers


class ForkedProcess:
    """What tests use of `subprocess.Popen`, text on all three streams."""

    def __init__(
        self, *arguments: str | Path, environment: Mapping[str, str] | None = None, folder: str | Path = "."
    ) -> None:
        """Start `python ARGUMENTS...`."""
        (stdin, to_it), (from_it, stdout), (errors, stderr) = (os.pipe() for _ in range(3))
        of_child = (stdin, stdout, stderr)
        self.args = [str(word) for word in arguments]
        try:
            self.pid, answers = ask(self.args, of_child, environment or os.environ, str(Path(folder).resolve()))
        finally:
            for stream in of_child:
                os.close(stream)
        self.stdin, self.stdout, self.stderr = os.fdopen(to_it, "w"), os.fdopen(from_it), os.fdopen(errors)
        self.returncode: int | None = None
        self._ended = threading.Event()
        threading.Thread(target=self._wait, args=[answers], daemon=True).start()

    def poll(self) -> int | None:
        """Its exit code, None while it runs."""
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """Its exit code.

        Raises:
            subprocess.TimeoutExpired: it does not end.
        """
        if not self._ended.wait(timeout):
            raise subprocess.TimeoutExpired(self.args, timeout or 0.0)
        assert self.returncode is not None, "the server of forked processes has ended"
        return self.returncode

    def communicate(self, timeout: float | None = None) -> tuple[str, str]:
        """What it has written until its end, which is waited for."""
        said: list[str] = ["", ""]

        def read(number: int, stream: IO[str]) -> None:
            said[number] = stream.read()

        self.stdin.close()
        readers = [
            threading.Thread(target=read, args=item, daemon=True) for item in enumerate((self.stdout, self.stderr))
        ]
        for reader in readers:
            reader.start()
        self.wait(timeout)
        for reader in readers:
            reader.join(timeout)
        return said[0], said[1]

    def send_signal(self, number: int) -> None:
        """Send it a signal, unless it has ended."""
        if self.returncode is None:
            # As subprocess.Popen does: it may have ended and not be collected yet.
            with suppress(ProcessLookupError):
                os.kill(self.pid, number)

    def terminate(self) -> None:
        """Ask it to end."""
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        """End it at once."""
        self.send_signal(signal.SIGKILL)

    def close(self) -> None:
        """End it if it runs, and close its streams."""
        self.kill()
        self.wait(PATIENCE)
        for stream in (self.stdin, self.stdout, self.stderr):
            stream.close()

    def _wait(self, answers: IO[str]) -> None:
        with answers:
            status = answers.readline()
        if status:
            self.returncode = os.waitstatus_to_exitcode(int(status))
        self._ended.set()


def run_forked(
    *arguments: str | Path, environment: Mapping[str, str] | None = None, folder: str | Path = "."
) -> subprocess.CompletedProcess[str]:
    """Run `python ARGUMENTS...` to its end, as `subprocess.run` does."""
    process = ForkedProcess(*arguments, environment=environment, folder=folder)
    try:
        out, errors = process.communicate(PATIENCE)
        return subprocess.CompletedProcess(process.args, process.wait(), out, errors)
    finally:
        process.close()


def main() -> None:
    """Be `python ARGUMENTS...`: end when and as it ends, and hold none of its streams meanwhile."""
    arguments = [word for word in sys.argv[1:] if word != "-u"]
    _, answers = ask(arguments, (0, 1, 2), os.environ, os.getcwd())
    nothing = os.open(os.devnull, os.O_RDWR)
    for stream in (0, 1):
        os.dup2(nothing, stream)
    # An interrupt of the whole group reaches it as well.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    status = answers.readline()
    os._exit(max(os.waitstatus_to_exitcode(int(status)), 1) if status else 1)


if __name__ == "__main__":
    main()
