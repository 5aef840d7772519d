"""A client in a process of its own, as a planner has it: prints when it received a grid. Started by `benchmarks.node`.

`python benchmarks/planner_peer.py ENDPOINT`: for each line of input, the number of a pause, it prints one line, the
monotonic clock [s] at the instant when `wait_for_step` returned the grid of that pause.
"""

from __future__ import annotations

import sys
import time

import guara_perception as gp

TIMEOUT_S = 120.0


def wait_for_pauses() -> None:
    """Wait for the grid of each pause whose number comes on the standard input."""
    with gp.TerrainClient(sys.argv[1], timeout=TIMEOUT_S) as client:
        print("ready", flush=True)
        for line in sys.stdin:
            client.wait_for_step(int(line), timeout=TIMEOUT_S)
            print(time.monotonic(), flush=True)


if __name__ == "__main__":
    wait_for_pauses()
