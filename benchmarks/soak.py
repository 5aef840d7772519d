"""Long run of real processes: a router, a node and planners; node and planners are killed repeatedly.

`python -m benchmarks.soak [--minutes 20] [--period 15]`. `endurance` shows that no process grows.
"""

from __future__ import annotations

import random
import sys
import time
from collections import Counter

import numpy as np

import transport
from benchmarks.command import options
from benchmarks.peers import PATIENCE, SHAPE, Child, ended, free_endpoint, report


def run_planner(endpoint: str) -> None:
    """A planner that asks for scans and prints its counts about twice a second."""
    counts: Counter[str] = Counter()
    newest: dict[str, int] = {}
    with transport.open_client(endpoint, timeout=PATIENCE) as session:
        client = transport.PerceptionClient(session)

        def take(terrain: transport.TerrainMessage) -> None:
            counts["grids"] += 1
            counts["of other values than sent"] += bool(np.any(terrain.layers["variance"] != 1))
            # A node that was started again counts from 1 again; its scans are later all the same.
            counts["out of order"] += terrain.scan_end < newest.get(terrain.extent, 0)
            newest[terrain.extent] = terrain.scan_end

        for extent in ("footprint", "map"):
            client.on_terrain(take, extent=extent)
        report(ready=True)
        stop = ended()
        while not stop.wait(0.5):
            try:
                client.request_scan(timeout=5.0)
                counts["scans"] += 1
            except transport.TransportError as error:
                counts[type(error).__name__] += 1
            report(counts=counts)


def main() -> None:
    """Command line."""
    asked = options(__doc__, minutes=(20.0, "how long; at most 120"), period=(15.0, "[s] between two kills"))
    endpoint, chance = free_endpoint(), random.Random(0)
    counts, kills = Counter[str](), Counter[str]()
    router = Child("router", endpoint)
    scanner = "scanner", endpoint, "connect", *map(str, SHAPE)
    node = Child(*scanner)
    # The first planner is never killed.
    lasting, other = (Child("planner", endpoint, module="soak") for _ in range(2))
    end = time.monotonic() + 60.0 * min(asked.minutes, 120.0)
    try:
        while time.monotonic() < end:
            time.sleep(min(asked.period, max(0.1, end - time.monotonic())))
            victim = chance.choice(["node", "node", "planner"])
            kills[victim] += 1
            if victim == "node":
                node.end()
                node = Child(*scanner)
            else:
                other.end()
                counts += other.counts
                other = Child("planner", endpoint, module="soak")
        time.sleep(2.0)
    finally:
        for child in (lasting, other, node, router):
            child.end()
            counts += child.counts
    print(f"kill -9: {dict(kills)}")
    print("counts of all planners:", ", ".join(f"{name} {count}" for name, count in sorted(counts.items())))
    for name in ("out of order", "of other values than sent"):
        print(f"{'ok  ' if not counts[name] else 'FAIL'} {name}: {counts[name]}")
    sys.exit(1 if counts["out of order"] or counts["of other values than sent"] or not counts["scans"] else 0)


if __name__ == "__main__":
    main()
