"""Processes of one script without the second that each needs to import everything: forked where that is done already.

A server imports the script's modules once and forks for each request. What it gives is a process of its own, with its
own streams, signals and end, as `subprocess.Popen` would start it. Run as `python forked.py SOCKET SCRIPT` it is that
server.
"""

from __future__ import annotations

import gc
import json
import os
import runpy
import select
import signal
import socket
import subprocess
import sys
import threading
from pathlib import Path
from typing import IO


class ForkServer:
    """Starts processes of one script; ends with the process that made it."""

    def __init__(self, script: Path) -> None:
        """Start the server."""
        own_end, server_end = socket.socketpair()
        command = [sys.executable, str(Path(__file__)), str(server_end.fileno()), str(script)]
        self._server = subprocess.Popen(command, pass_fds=[server_end.fileno()], stdin=subprocess.DEVNULL)
        server_end.close()
        self._socket, self._lines = own_end, own_end.makefile("r")
        self._started: dict[int, ForkedProcess] = {}
        self._answers: list[ForkedProcess] = []
        self._heard = threading.Condition()
        self._asking = threading.Lock()
        threading.Thread(target=self._listen, daemon=True).start()

    def start(self, *arguments: str) -> ForkedProcess:
        """A process of the script with these arguments, in this environment and folder."""
        streams = [os.pipe() for _ in range(3)]
        (stdin, to_it), (from_it, stdout), (errors, stderr) = streams
        request = json.dumps({"arguments": arguments, "environment": dict(os.environ), "folder": os.getcwd()}).encode()
        with self._asking:
            header = len(request).to_bytes(4, "big")
            socket.send_fds(self._socket, [header], [stdin, stdout, stderr])
            self._socket.sendall(request)
            for end in (stdin, stdout, stderr):
                os.close(end)
            with self._heard:
                assert self._heard.wait_for(lambda: self._answers, 180.0), "the server of forked processes has ended"
                process = self._answers.pop()
        process.stdin, process.stdout, process.stderr = os.fdopen(to_it, "w"), os.fdopen(from_it), os.fdopen(errors)
        return process

    def close(self) -> None:
        """End the server; its processes stay."""
        self._socket.shutdown(socket.SHUT_RDWR)
        self._server.wait(180.0)

    def _listen(self) -> None:
        for line in self._lines:
            kind, pid, *status = (int(word) for word in line.split())
            with self._heard:
                if kind == 0:
                    self._started[pid] = ForkedProcess(pid, self._heard)
                    self._answers.append(self._started[pid])
                else:
                    self._started.pop(pid).returncode = os.waitstatus_to_exitcode(status[0])
                self._heard.notify_all()


class ForkedProcess:
    """What tests use of `subprocess.Popen`."""

    stdin: IO[str]
    stdout: IO[str]
    stderr: IO[str]

    def __init__(self, pid: int, heard: threading.Condition) -> None:
        """It runs; `heard` is notified when it ends."""
        self.pid = pid
        self.returncode: int | None = None
        self._heard = heard

    def poll(self) -> int | None:
        """Its exit code, None while it runs."""
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """Its exit code.

        Raises:
            subprocess.TimeoutExpired: it does not end.
        """
        with self._heard:
            if not self._heard.wait_for(lambda: self.returncode is not None, timeout):
                raise subprocess.TimeoutExpired(f"process {self.pid}", timeout or 0.0)
            assert self.returncode is not None
            return self.returncode

    def send_signal(self, number: int) -> None:
        """Send it a signal, unless it has ended."""
        if self.returncode is None:
            os.kill(self.pid, number)

    def kill(self) -> None:
        """End it at once."""
        self.send_signal(signal.SIGKILL)


def serve(requests: socket.socket, script: str) -> list[str]:
    """Fork for each request; return the arguments in each child, and end with the reader of the answers."""
    wake, woken = os.pipe()
    os.set_blocking(woken, False)
    signal.set_wakeup_fd(woken)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    while True:
        ready, _, _ = select.select([requests, wake], [], [])
        if wake in ready:
            os.read(wake, 4096)
            while (ended := _ended()) is not None:
                requests.sendall(f"1 {ended[0]} {ended[1]}\n".encode())
        if requests not in ready:
            continue
        header, streams, _, _ = socket.recv_fds(requests, 4, 3)
        if not header:
            os._exit(0)
        request = json.loads(requests.recv(int.from_bytes(header, "big"), socket.MSG_WAITALL))
        pid = os.fork()
        if pid:
            for stream in streams:
                os.close(stream)
            requests.sendall(f"0 {pid}\n".encode())
            continue
        signal.set_wakeup_fd(-1)
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        requests.close()
        for number, stream in enumerate(streams):
            os.dup2(stream, number)
            os.close(stream)
        os.close(wake)
        os.close(woken)
        os.chdir(request["folder"])
        os.environ.clear()
        os.environ.update(request["environment"])
        return [script, *request["arguments"]]


def _ended() -> tuple[int, int] | None:
    """Process and status of a child that has ended."""
    try:
        pid, status = os.waitpid(-1, os.WNOHANG)
    except ChildProcessError:
        return None
    return (pid, status) if pid else None


if __name__ == "__main__":
    # As a program: all that the script imports, and what its first message would wait for.
    runpy.run_path(sys.argv[2], run_name="imported")
    from transport.messages.typestore import warm_up

    warm_up()
    gc.freeze()
    sys.argv = serve(socket.socket(fileno=int(sys.argv[1])), sys.argv[2])
    sys.stdin = open(0, closefd=False)  # noqa: SIM115
    runpy.run_path(sys.argv[0], run_name="__main__")
