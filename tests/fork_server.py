"""The server of `forked.py`: `python fork_server.py LISTENER [PYTEST ARGUMENTS...]`.

It imports what tests and programs import, then forks for each request. It has one thread, for a fork keeps no other.
"""

from __future__ import annotations

import gc
import importlib
import io
import json
import os
import pkgutil
import runpy
import select
import signal
import socket
import sys
from pathlib import Path
from types import ModuleType

ROOT = Path(__file__).parent.parent
PACKAGES = ("guara_perception", "transport", "drivers", "kinematics")
# What the packages import when it is needed first.
LATER = ("matplotlib.pyplot", "scipy.ndimage", "scipy.optimize", "scipy.spatial", "mcap.reader", "mcap.writer")


def import_everything(pytest_arguments: list[str]) -> None:
    """Import the tests if there are arguments, all modules that need no extra, and what they would import later."""
    if pytest_arguments:
        import pytest

        # A module that cannot be imported is reported by the workers, which try again.
        pytest.main([*pytest_arguments, "-n0", "--collect-only", "-qqq"])
    for package in PACKAGES:
        folder = importlib.import_module(package).__path__
        for module in pkgutil.walk_packages(folder, f"{package}.", onerror=lambda _: None):
            if not module.name.endswith("__main__"):
                try:
                    importlib.import_module(module.name)
                except ImportError:
                    continue
    for name in LATER:
        importlib.import_module(name)
    importlib.import_module("transport.messages.typestore").warm_up()
    threads = len(os.listdir("/proc/self/task"))
    assert threads == 1, f"importing the tests has started {threads - 1} threads, which a fork would lose"
    gc.freeze()


def serve(listener: socket.socket) -> list[str]:
    """Fork for each request; return its arguments in the child. The server and all children end with its parent."""
    wake, woken = os.pipe()
    os.set_blocking(woken, False)
    signal.set_wakeup_fd(woken)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    children: dict[int, socket.socket] = {}
    while True:
        ready, _, _ = select.select([listener, wake, 0], [], [])
        if 0 in ready:
            for pid in children:
                os.kill(pid, signal.SIGKILL)
                os.waitpid(pid, 0)
            os._exit(0)
        if wake in ready:
            os.read(wake, 4096)
            report_ends(children)
        if listener not in ready:
            continue
        connection, _ = listener.accept()
        header, streams, _, _ = socket.recv_fds(connection, 4, 3)
        if len(header) < 4:
            connection.close()
            continue
        request = json.loads(connection.recv(int.from_bytes(header, "big"), socket.MSG_WAITALL))
        pid = os.fork()
        if pid:
            for stream in streams:
                os.close(stream)
            children[pid] = connection
            answer(connection, pid)
            continue
        signal.set_wakeup_fd(-1)
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        signal.signal(signal.SIGHUP, signal.SIG_DFL)
        signal.signal(signal.SIGINT, signal.default_int_handler)
        for other in (listener, connection, *children.values()):
            other.close()
        for number, stream in enumerate(streams):
            os.dup2(stream, number)
        for descriptor in (*streams, wake, woken):
            os.close(descriptor)
        os.chdir(request["folder"])
        os.environ.clear()
        os.environ.update(request["environment"])
        return request["arguments"]


def report_ends(children: dict[int, socket.socket]) -> None:
    """Report how each child has ended to the process that asked for it."""
    while children:
        pid, status = os.waitpid(-1, os.WNOHANG)
        if not pid:
            return
        with children.pop(pid) as connection:
            answer(connection, status)


def answer(connection: socket.socket, number: int) -> None:
    """Send a line to a process that may have ended."""
    try:
        connection.sendall(f"{number}\n".encode())
    except OSError:
        pass


def run(arguments: list[str]) -> None:
    """What `python ARGUMENTS...` runs: `-c CODE`, `-m MODULE` or a script, with arguments."""
    # As a new interpreter opens them; the server's own remember what its streams were.
    is_unbuffered = bool(os.environ.get("PYTHONUNBUFFERED"))
    binary = open(1, "wb", 0 if is_unbuffered else -1, closefd=False)
    sys.stdin, sys.stdout = open(0, closefd=False), io.TextIOWrapper(binary, write_through=is_unbuffered)
    sys.stderr = open(2, "w", 1, closefd=False)
    sys.path[0] = "" if arguments[0].startswith("-") else str(Path(arguments[0]).resolve().parent)
    if arguments[0] == "-m":
        sys.argv = ["-m", *arguments[2:]]
        name = arguments[1] + ".__main__" * hasattr(sys.modules.get(arguments[1]), "__path__")
        # Imported already, which runpy warns of.
        sys.modules.pop(name, None)
        runpy.run_module(name, run_name="__main__", alter_sys=True)
        return
    main = sys.modules["__main__"] = ModuleType("__main__")
    if arguments[0] == "-c":
        # Without a `__file__`: processes that `multiprocessing` starts would look for it.
        code, file, sys.argv = arguments[1], "<string>", ["-c", *arguments[2:]]
    else:
        code, file, sys.argv = Path(arguments[0]).read_text(), arguments[0], arguments
        main.__file__ = file
    exec(compile(code, file, "exec", dont_inherit=True), vars(main))


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    sys.path[0] = str(ROOT)
    listening = socket.socket(fileno=int(sys.argv[1]))
    import_everything(sys.argv[2:])
    run(serve(listening))
