"""Many robots with a planner each on one router: delays, traffic, processor time and memory.

Usage: python -m benchmarks transport fleet [--sizes 1 5 20 50 100] [--seconds 15] [--held 10]

Each robot publishes what a node does, footprint and fused map among it, every 3 s from a random instant on; each
planner receives both extents of its own robot. All over TCP on one machine, without shared memory; each process holds
up to ten robots or planners. A delay is from the call that publishes to the grid in the planner's callback. Processor
time is that of a robot and second while nothing is published (idle), and the additional time of one pause. Then 20
robots, over TCP and over mutual TLS with the configuration that `guara security router` writes, publish in turns, at
the same instant, and after a restart of their router.
"""

from __future__ import annotations

import json
import os
import random
import sys
import tempfile
import threading
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

import transport
from benchmarks.command import Table, options
from benchmarks.peers import PATIENCE, Pauses, Peer, free_endpoint, free_port, peers, percentiles, report
from benchmarks.rounds import resident_mb
from guara_perception.arrays import Float
from transport.security.folder import CONFIGURATION
from transport.security.router_folder import make_router

SIZES = (1, 5, 20, 50, 100)
# Robots, or planners, of one process.
HELD = 10
# Cells of the fused map as a robot publishes it: 1.8 MB with all layers.
MAP_SHAPE = (140, 320)
# Time between two pauses of a robot, and duration of the measurement of the idle processor time [s].
PERIOD, IDLE = 3.0, 6.0
# Robots of the comparison with TLS, of the router's restart, and of the bursts; number of these.
COMPARED, BURSTS = 20, 5
# Limits with the largest fleet, met at the limit itself: the longest delay, and the 99th percentile of delays [ms].
WORST_MS, HIGH_MS = 100.0, 50.0
EXTENTS = ("footprint", "map")
COUNTS = ("missed", "fetched")
PERCENTS = (50, 99, 100)
TICKS = os.sysconf("SC_CLK_TCK")


def run_robots(endpoint: str, security: str, *names: str) -> None:
    """Robots with a session each; each line of the standard input asks them to publish for some time, or once."""
    pauses, servers = Pauses(MAP_SHAPE), []
    for name in names:
        folder = f"{security}/{name}" if security else None
        session = transport.open_node(connect=endpoint, security=folder, timeout=PATIENCE)
        servers.append(transport.PerceptionServer(session, robot=name, name_timeout=PATIENCE))
    report(ready=True)
    for line in sys.stdin:
        seconds, count = json.loads(line)["seconds"], 0
        start = time.monotonic()
        # Each from a random phase of the period on; all at once where they publish once.
        due = [(start + random.random() * PERIOD * bool(seconds), server) for server in servers]
        while due:
            due_at, server = min(due, key=lambda entry: entry[0])
            due.remove((due_at, server))
            if due_at > start + seconds:
                continue
            time.sleep(max(0.0, due_at - time.monotonic()))
            pauses.publish(server)
            count += 1
            due.append((due_at + PERIOD, server))
        if seconds:
            for server in servers:
                server.flush(PATIENCE)
        report(published=count)


def run_planners(endpoint: str, security: str, *names: str) -> None:
    """Planners with a client each; each line of the standard input asks what arrived since the last one."""
    lock = threading.Lock()
    sizes = Pauses(MAP_SHAPE).sizes
    arrived: list[tuple[str, str, float, float]] = []

    def take(terrain: transport.TerrainMessage) -> None:
        now = time.time_ns()
        with lock:
            arrived.append((terrain.extent, terrain.robot, (now - terrain.scan_end) * 1e-6, now * 1e-9))

    receivers = []
    for name in names:
        folder = f"{security}/{name}/planner" if security else None
        session = transport.open_client(endpoint, security=folder, timeout=PATIENCE)
        client = transport.PerceptionClient(session, robot=name)
        for extent in EXTENTS:
            receivers.append(client.receiver(extent))
            receivers[-1].on_newest(lambda received: take(received.message))
    report(ready=True)
    for _ in sys.stdin:
        with lock:
            taken, arrived[:] = list(arrived), []
        report(
            delays_ms={extent: [delay for each, _, delay, _ in taken if each == extent] for extent in EXTENTS},
            newest={robot: instant for _, robot, _, instant in taken},
            bytes=sum(sizes[extent] for extent, *_ in taken),
            **{name: sum(getattr(receiver, name) for receiver in receivers) for name in COUNTS},
        )


class Fleet:
    """A router, robots and planners that run, ready for a measurement."""

    def __init__(self, stack: ExitStack, size: int, keys: Path | None = None, *, held: int = HELD) -> None:
        """Start all.

        Args:
            stack: ends them.
            size: number of robots.
            keys: an empty folder, which gets the keys of mutual TLS; None = plain TCP.
            held: robots of one process.
        """
        self.names = [f"r{number}" for number in range(size)]
        self._peer = stack.enter_context(peers())
        endpoint, folder = free_endpoint(), ""
        self._router_at = endpoint
        if keys is not None:
            port, folder = free_port(), str(keys / "keys")
            made = make_router(keys / "keys", self.names, listen=f"tls/127.0.0.1:{port}")
            endpoint = f"tls/localhost:{port}"
            self._router_at = str(made / CONFIGURATION)
        self.start_router()
        groups = [self.names[first : first + held] for first in range(0, size, held)]
        self.robots, self.planners = (
            [self._peer(role, endpoint, folder, *group, module="fleet") for group in groups]
            for role in ("robots", "planners")
        )
        self._counts = dict.fromkeys(COUNTS, 0)

    def start_router(self) -> None:
        """Start the router."""
        self.router = self._peer("router", self._router_at)

    def publish(self, seconds: float = 0.0) -> int:
        """Let all robots publish for this long, at once and once if 0; return the number of pauses."""
        for peer in self.robots:
            peer.send(seconds=seconds)
        return sum(int(peer.receive()["published"]) for peer in self.robots)

    def arrived(self) -> dict[str, Any]:
        """Figures of the grids that arrived since the last call: delays by extent, newest instants, bytes, counts."""
        for peer in self.planners:
            peer.send()
        reports = [peer.receive() for peer in self.planners]
        found: dict[str, Any] = {"newest": {}, "bytes": sum(each["bytes"] for each in reports)}
        for extent in EXTENTS:
            delays = [delay for each in reports for delay in each["delays_ms"][extent]]
            found[f"{extent}_arrived"] = len(delays)
            found[f"{extent}_ms"] = percentiles(delays, *PERCENTS)
        for each in reports:
            found["newest"] |= each["newest"]
        for name in COUNTS:
            total = sum(each[name] for each in reports)
            found[name], self._counts[name] = total - self._counts[name], total
        return found


def processor_seconds(peer: Peer) -> float:
    """Processor time that a process has used [s]."""
    # After the name in parentheses; utime and stime are fields 14 and 15 of proc(5), which counts from 1.
    fields = Path(f"/proc/{peer.popen.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS


def measure(fleet: Fleet, seconds: float) -> dict[str, Any]:
    """Figures of one fleet."""
    size = len(fleet.names)
    # The first pause includes all one-time work and is not measured.
    fleet.publish()
    time.sleep(1.0)
    fleet.arrived()
    roles = {"router": [fleet.router], "robot": fleet.robots, "planner": fleet.planners}

    def used() -> Float:
        return np.array([sum(map(processor_seconds, group)) for group in roles.values()])

    before = used()
    time.sleep(IDLE)
    # Share of one core that each role uses while nothing is published.
    idle = (used() - before) / IDLE
    before, start = used(), time.monotonic()
    pauses = fleet.publish(seconds)
    # A receiver that notices a missing grid fetches it within a second.
    time.sleep(2.0)
    took = time.monotonic() - start
    spent, found = used() - before, fleet.arrived()
    by_role = {
        # Per cent of one core, for each robot or planner.
        "processor": 100 * spent / took / (1, size, size),
        "mb": [np.mean([resident_mb(peer.popen.pid) for peer in group]) for group in roles.values()],
        "idle_ms_per_s": 1e3 * idle / size,
        "ms_per_pause": 1e3 * (spent - idle * took) / max(pauses, 1),
    }
    figures = {"robots": size, "pauses": pauses, "mb_per_s": found["bytes"] / 1e6 / seconds}
    return figures | found | by_role | {"machine_busy": spent.sum() / took / (os.cpu_count() or 1)}


def bursts(fleet: Fleet, count: int) -> dict[str, Any]:
    """All robots publish at the same instant, `count` times."""
    fleet.arrived()
    for _ in range(count):
        fleet.publish()
        time.sleep(PERIOD)
    return fleet.arrived()


def storm(fleet: Fleet) -> dict[str, Any]:
    """Restart the router; return how many planners then got the newest map, and how long after the restart."""
    fleet.arrived()
    fleet.router.end()
    fleet.publish()
    fleet.start_router()
    ready = time.time()
    came: dict[str, float] = {}
    deadline = time.monotonic() + 30.0
    while len(came) < len(fleet.names) and time.monotonic() < deadline:
        time.sleep(0.2)
        came |= fleet.arrived()["newest"]
    # A planner can reconnect before the router's ready message has been read here.
    after = [max(0.0, arrival - ready) for arrival in came.values()]
    newest = {"newest_p50_s": float(np.median(after or [np.inf])), "newest_worst_s": max(after, default=np.inf)}
    return {"robots": len(fleet.names), "came": len(came), **newest}


def table_row(figures: dict[str, Any]) -> tuple[Any, ...]:
    """Pauses, delays, grids that did not arrive at first, and cost by router, robot and planner."""
    delays = [delay for extent in EXTENTS for delay in figures[f"{extent}_ms"]]
    costs = (
        " / ".join(f"{each:.2f}" for each in figures[key]) for key in ("processor", "idle_ms_per_s", "ms_per_pause")
    )
    counts = figures["missed"], figures["fetched"], figures["mb_per_s"], figures["mb"][0]
    return figures["pauses"], *delays, *counts, *costs, figures["machine_busy"]


def main() -> None:
    """Many robots and planners on one router [--sizes N N, --seconds S, --held N]."""
    asked = options(
        __doc__,
        sizes=([*SIZES], "numbers of robots"),
        seconds=(15.0, "each fleet publishes for this long; at most 60"),
        held=(HELD, "robots, or planners, of one process; 1 takes 65 MB each"),
    )
    seconds, held = min(max(asked.seconds, 1.0), 60.0), min(max(asked.held, 1), 100)
    print("delays [ms] at the median, 99th percentile and worst; the rest by router / robot / planner")
    table = Table(
        "robots:<8 | pauses:d | footprint:9.1f | p99:5.1f | worst:5.1f | map:5.1f | p99:5.1f | worst:5.1f | missed:d | "
        "fetched:d | MB/s:5.1f | router MB:.0f | % of a core:<20 | idle ms a second:<20 | ms a pause:<20 | machine:.0%"
    )
    for size in sorted(asked.sizes):
        with ExitStack() as stack:
            largest = measure(Fleet(stack, size, held=held), seconds)
        table.row(str(size), *table_row(largest))
    lines = []
    for is_secured in (False, True):
        with ExitStack() as stack:
            keys = Path(stack.enter_context(tempfile.TemporaryDirectory())) if is_secured else None
            fleet, name = Fleet(stack, COMPARED, keys, held=held), f"{COMPARED} {'TLS' if is_secured else 'TCP'}"
            table.row(name, *table_row(measure(fleet, seconds)))
            row = bursts(fleet, BURSTS)
            lines.append(
                f"{name}, all at once: {row['map_arrived']} of {COMPARED * BURSTS} maps, 99th percentile and worst "
                f"{row['map_ms'][1]:.1f} and {row['map_ms'][2]:.1f} ms; {row['fetched']} grids were fetched"
            )
            row = storm(fleet)
            lines.append(
                f"{name}, router restarted: {row['came']} of {COMPARED} planners had the newest grid, half of them "
                f"{row['newest_p50_s']:.2f} s and the last {row['newest_worst_s']:.2f} s after it was back"
            )
    print(*lines, sep="\n")
    is_met = all(high <= HIGH_MS and worst <= WORST_MS for _, high, worst in (largest[f"{e}_ms"] for e in EXTENTS))
    sys.exit(not is_met)
