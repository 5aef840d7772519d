"""Ports that no other test takes: each worker has a range of its own, below those that the kernel hands out."""

import os
import socket
from itertools import count

FIRST, EACH, RANGES = 12_000, 1_000, 20
_taken = count()


def free_port() -> int:
    """A TCP port of this machine that nobody uses."""
    # Workers of one run are numbered; runs beside each other start at another range. Asked for here, because this file
    # is imported before the workers are forked.
    worker = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
    run = sum(os.environ.get("PYTEST_XDIST_TESTRUNUID", str(os.getpid())).encode())
    first = FIRST + (run + worker) % RANGES * EACH
    while True:
        port = first + next(_taken) % EACH
        with socket.socket() as probe:
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                continue
        return port


def free_endpoint() -> str:
    """A Zenoh endpoint on this machine that nobody uses."""
    return f"tcp/127.0.0.1:{free_port()}"
