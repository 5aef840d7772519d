"""A long run with real processes: a router, a node and planners, the last two killed again and again; prints counts.

Usage: python -m benchmarks.soak [--minutes 20] [--period 15] [--shared-memory]
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import random
import sys
import threading
import time
from collections import Counter
from pathlib import Path
from typing import Any

import transport
from benchmarks.peers import Peer, free_endpoint
from benchmarks.transport_peer import is_whole, make_terrain


def say(**reply: Any) -> None:
    """A line of JSON to the parent."""
    print(json.dumps(reply), flush=True)


def run_router(endpoint: str, shared: bool) -> None:
    """A Zenoh router and nothing else."""
    with transport.open_node(listen=endpoint, shared_memory=shared):
        say(ready=True)
        sys.stdin.read()


def run_node(endpoint: str, shared: bool) -> None:
    """A node that answers scan requests with grids of both extents."""
    base = make_terrain(1)
    with transport.open_node(connect=endpoint, timeout=30.0, shared_memory=shared) as session:
        server = transport.PerceptionServer(session)

        def scan(job: transport.ScanJob) -> transport.TerrainMessage:
            now = time.time_ns()
            for extent in ("map", "footprint"):
                number = server.next_sequence(extent)
                made = dataclasses.replace(
                    base, extent=extent, sequence=number, step=number, stamp=now, scan_start=now, scan_end=now
                )
                server.publish(made)
            return made

        server.serve_scans(scan)
        say(ready=True)
        sys.stdin.read()


def run_planner(endpoint: str, shared: bool) -> None:
    """A planner that asks for scans and prints its counts about twice a second."""
    counts: Counter[str] = Counter()
    newest: dict[str, int] = {}
    with transport.open_client(endpoint, timeout=30.0, shared_memory=shared) as session:
        client = transport.PerceptionClient(session)

        def take(terrain: transport.TerrainMessage) -> None:
            counts["grids"] += 1
            counts["of other values than sent"] += not is_whole(dataclasses.replace(terrain, sequence=1))
            # A node that was started again counts from 1 again; its scans are later all the same.
            counts["out of order"] += terrain.scan_end < newest.get(terrain.extent, 0)
            newest[terrain.extent] = terrain.scan_end

        for extent in ("footprint", "map"):
            client.on_terrain(take, extent=extent)
        say(ready=True)
        stop = threading.Event()

        def listen() -> None:
            sys.stdin.read()
            stop.set()

        threading.Thread(target=listen, daemon=True).start()
        while not stop.wait(0.5):
            try:
                client.request_scan(timeout=5.0)
                counts["scans"] += 1
            except transport.TransportError as error:
                counts[type(error).__name__] += 1
            status = Path("/proc/self/status").read_text()
            memory = next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmRSS"))
            descriptors = len(list(Path("/proc/self/fd").iterdir()))
            say(counts=counts, memory_mb=memory / 1024, descriptors=descriptors)


class Child(Peer):
    """One process of this module, with its first and its last report."""

    def __init__(self, role: str, endpoint: str, shared: bool) -> None:
        """Start it and wait until it is ready."""
        super().__init__("--role", role, "--endpoint", endpoint, *["--shared-memory"] * shared, module="soak")
        self.last: dict[str, Any] = {}
        self.first: dict[str, Any] = {}
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        while report := self.hear():
            self.last = report
            self.first = self.first or report

    def kill(self) -> Counter[str]:
        """End it with kill -9; what it had counted."""
        self.end()
        return Counter(self.last.get("counts", {}))


def main() -> None:
    """Run the soak, or one of its processes."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=20.0, help="how long; at most 120")
    parser.add_argument("--period", type=float, default=15.0, help="[s] between two kills")
    parser.add_argument(
        "--shared-memory", dest="shared", action="store_true", help="to see what it keeps of dead nodes"
    )
    parser.add_argument("--role", choices=["router", "node", "planner"], help=argparse.SUPPRESS)
    parser.add_argument("--endpoint", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.role:
        {"router": run_router, "node": run_node, "planner": run_planner}[options.role](options.endpoint, options.shared)
        return
    endpoint, chance = free_endpoint(), random.Random(0)
    end = time.monotonic() + 60.0 * min(options.minutes, 120.0)
    counts, kills = Counter[str](), Counter[str]()
    router = Child("router", endpoint, options.shared)
    node = Child("node", endpoint, options.shared)
    # The first planner lives through all; the second is killed.
    lasting, other = (Child("planner", endpoint, options.shared) for _ in range(2))
    memory: list[float] = []
    try:
        while time.monotonic() < end:
            time.sleep(min(options.period, max(0.1, end - time.monotonic())))
            victim = chance.choice(["node", "node", "planner"])
            kills[victim] += 1
            if victim == "node":
                memory.append(lasting.last["memory_mb"])
                node.kill()
                node = Child("node", endpoint, options.shared)
            else:
                counts += other.kill()
                other = Child("planner", endpoint, options.shared)
        time.sleep(2.0)
    finally:
        first, last = lasting.first, lasting.last
        for child in (lasting, other, node, router):
            counts += child.kill()
    print(f"kill -9: {dict(kills)}")
    print("counts of all planners:", ", ".join(f"{name} {count}" for name, count in sorted(counts.items())))
    print(
        f"the planner that lived on: {first['memory_mb']:.1f} to {last['memory_mb']:.1f} MB, "
        f"{first['descriptors']} to {last['descriptors']} descriptors over {kills['node']} restarts of the node"
    )
    series = [f"{restarts}: {megabytes:.1f}" for restarts, megabytes in enumerate(memory) if restarts % 5 == 0]
    print("its memory [MB] by restarts of the node before:", ", ".join(series))
    for name in ("out of order", "of other values than sent"):
        print(f"{'ok  ' if not counts[name] else 'FAIL'} {name}: {counts[name]}")
    sys.exit(1 if counts["out of order"] or counts["of other values than sent"] or not counts["scans"] else 0)


if __name__ == "__main__":
    main()
