"""A planner in a process of its own: says when each grid was in its hands. Started by `benchmarks.node`.

`python benchmarks/planner_peer.py ENDPOINT`: for each line with the number of a pause one line with the monotonic clock
[s] at which `wait_for_step` gave its grid.
"""

from __future__ import annotations

import sys
import time

import guara_perception as gp

TIMEOUT_S = 120.0


def wait_for_pauses() -> None:
    """Wait for the grids of the pauses that are named on the standard input."""
    with gp.TerrainClient(sys.argv[1], timeout=TIMEOUT_S) as client:
        print("ready", flush=True)
        for line in sys.stdin:
            client.wait_for_step(int(line), timeout=TIMEOUT_S)
            print(time.monotonic(), flush=True)


if __name__ == "__main__":
    wait_for_pauses()
