"""Delay of grids at a local planner, and its failures, while a viewer uses a slow link.

Usage: python -m benchmarks transport viewers [--scans 50]

A node, a planner that asks for scans and a viewer of both extents are processes of their own; the viewer comes through
a proxy that passes 2, 5 or 20 Mbit/s. Scans without a viewer and beside each link alternate in one run.
"""

from __future__ import annotations

import json
import random
import sys
import tempfile
import time
from collections import Counter, defaultdict
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import transport
from benchmarks.command import Table, options
from benchmarks.peers import free_endpoint, peers, percentiles, report
from testbed.slow_link import SlowLink
from transport.security.folder import init_security

# Rates of the viewer's link [Mbit/s]; 0: no viewer.
RATES = (0.0, 2.0, 5.0, 20.0)
# Rows and columns of the fused map: 2.3 MB with all layers.
MAP_SHAPE = ("240", "260")
EXTENTS = ("footprint", "map")
# Delays of the grids by extent [ms], and messages of the requests that "failed".
Delays = dict[str, list[Any]]
# Number of scans before the viewer changes: it joins, asks for what it missed, stays and leaves.
SCANS_PER_VIEWER = 10
# Time between two scans, and time limit of a request [s].
PERIOD, PATIENCE = 0.4, 20.0
# What a viewer may add to the 95th percentile [ms].
ALLOWED_MS = 50.0


def run_planner(endpoint: str, security: str) -> None:
    """Planner that asks for as many scans as each line says, and prints the delays of their grids [ms]."""
    session = transport.open_client(endpoint, security=security or None, timeout=PATIENCE)
    with transport.PerceptionClient(session) as client:
        client.receiver("map")
        report(ready=True)
        for line in sys.stdin:
            found: Delays = {"footprint": [], "map": [], "failed": []}
            for _ in range(json.loads(line)["scans"]):
                time.sleep(PERIOD)
                try:
                    sequence = client.request_scan(timeout=PATIENCE).sequence
                    for extent in EXTENTS:
                        received = client.receive(
                            lambda grid, n=sequence: grid.sequence == n,  # type: ignore[misc]
                            extent=extent,
                            timeout=PATIENCE,
                        )
                        found[extent].append((received.arrival_stamp - received.message.scan_end) * 1e-6)
                except transport.TransportError as error:
                    found["failed"].append(str(error))
            report(**found)


def run_viewer(_: str, security: str) -> None:
    """Viewer that joins at each endpoint that it reads, and leaves when it reads an empty one."""
    counts = Counter(received=0, missed=0)
    client: transport.PerceptionClient | None = None
    report(ready=True)
    for line in sys.stdin:
        if client is not None:
            for receiver in map(client.receiver, EXTENTS):
                counts.update(received=receiver.received, missed=receiver.missed)
            client.close()
            client = None
        endpoint = json.loads(line)["endpoint"]
        if endpoint:
            session = transport.open_client(endpoint, security=security or None, timeout=PATIENCE)
            client = transport.PerceptionClient(session)
            for extent in EXTENTS:
                client.receiver(extent)
        report(**counts)


def measure(scans: int, folders: dict[str, str]) -> tuple[dict[float, Delays], dict[float, dict[str, int]]]:
    """Delays and the viewer's counts by the rate of its link [Mbit/s]; `folders` of the roles, empty without TLS."""
    found: dict[float, Delays] = {rate: defaultdict(list) for rate in RATES}
    seen = {rate: {"received": 0, "missed": 0} for rate in RATES if rate}
    chance = random.Random(0)
    endpoint = free_endpoint()
    if folders:
        endpoint = endpoint.replace("tcp/127.0.0.1", "tls/localhost")
    with ExitStack() as stack:
        start = stack.enter_context(peers())
        start("scanner", endpoint, "listen", *MAP_SHAPE, folders.get("node", ""))
        planner = start("planner", endpoint, folders.get("planner", ""), module="viewers")
        viewers = {rate: start("viewer", endpoint, folders.get("viewer", ""), module="viewers") for rate in seen}
        links = {rate: stack.enter_context(SlowLink(endpoint, rate * 1e6 / 8)) for rate in seen}
        # Not measured: the first scans include what is done only once.
        planner.send(scans=3)
        planner.receive()
        left = dict.fromkeys(RATES, scans)
        while any(left.values()):
            for rate in chance.sample(RATES, len(RATES)):
                count = min(SCANS_PER_VIEWER, left[rate])
                left[rate] -= count
                if rate:
                    viewers[rate].send(endpoint=links[rate].endpoint)
                    viewers[rate].receive()
                planner.send(scans=count)
                for name, value in planner.receive().items():
                    found[rate][name] += value
                if rate:
                    viewers[rate].send(endpoint="")
                    seen[rate] = viewers[rate].receive()
    return found, seen


def main() -> None:
    """Delays of a local planner beside a viewer on a slow link [--scans N]."""
    asked = options(__doc__, scans=(50, "number of scans beside each kind of viewer; at most 1000"))
    is_met = True
    head = "link:<4 | beside:<11 | failed:>9 | footprint p50 ms:.1f | p95:6.1f | worst:6.1f | added p95:+.1f"
    table = Table(f"{head} | map p50:.1f | p95:6.1f | worst:6.1f | viewed:<")
    for link in ("tcp", "tls"):
        with tempfile.TemporaryDirectory() as folder:
            keys = init_security(Path(folder) / "keys") if link == "tls" else None
            folders = {role: str(keys / role) for role in ("node", "planner", "viewer")} if keys else {}
            found, seen = measure(min(max(asked.scans, 1), 1000), folders)
        for rate, delays in found.items():
            local, fused = (percentiles(delays[extent], 50, 95, 100) for extent in EXTENTS)
            above = local[1] - percentiles(found[0.0]["footprint"], 95)[0]
            is_met = is_met and not delays["failed"] and above <= ALLOWED_MS
            got = "{received}, missed {missed}".format(**seen[rate]) if rate else ""
            beside = f"{rate:g} Mbit/s" if rate else "no viewer"
            print(*(f"failed: {message}\n" for message in delays["failed"]), sep="", end="")
            table.row(link, beside, f"{len(delays['failed'])} of {asked.scans}", *local, above, *fused, got)
    print(f"{'ok  ' if is_met else 'FAIL'} no request fails, p95 at most {ALLOWED_MS:g} ms above that without a viewer")
    sys.exit(not is_met)
