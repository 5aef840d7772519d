"""Run an emulated laser board as a separate process: `python -m testbed.remote_board`."""

from __future__ import annotations

import argparse
import signal
import sys
import threading
from collections.abc import Sequence

from drivers.emulator.config import EmulatorConfig
from testbed.bench_board import BenchBoard
from testbed.remote_board.server import EmulatorServer


def main(arguments: Sequence[str] | None = None) -> int:
    """Listen, print `ready ADDRESS`, and serve until SIGINT or SIGTERM; return the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m testbed.remote_board",
        description="Emulated laser board; connect with testbed.remote_board.remote_backend(ADDRESS).",
        epilog="example: python -m testbed.remote_board --listen 127.0.0.1:7500",
    )
    parser.add_argument(
        "--listen",
        default="127.0.0.1:0",
        metavar="ADDRESS",
        help="127.0.0.1:PORT (0, the default: any free port) or unix:PATH",
    )
    parser.add_argument("--serial", default="EMU0001", help="serial number of the board")
    options = parser.parse_args(arguments)
    try:
        server = EmulatorServer(BenchBoard(EmulatorConfig(serial=options.serial)), options.listen)
    except (OSError, ValueError) as error:
        print(f"cannot listen: {error}", file=sys.stderr)
        return 2
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    threading.Thread(target=server.serve_forever, daemon=True).start()
    print(f"ready {server.address}", flush=True)
    stop.wait()
    server.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
