"""Many robots with a planner each on one router: delays, traffic, processor time, memory, and how they grow.

Usage: python -m benchmarks.fleet [--sizes 1,5,20,50,100] [--seconds 15] [--held 10] [--bursts 5] [--wait-ms 20]
       [--json]

Each robot publishes what a node does, footprint and fused map among it, every 3 s from a random instant on; each
planner receives both extents of its own robot. All over TCP on one machine, without shared memory; each process holds
up to ten robots or planners. A delay is from the call that publishes to the grid in the planner's callback. Below each
line of the table stands the processor time: while nobody publishes (idle), and what one pause costs beyond that. Then
follow 20 robots over TCP, bursts in which these publish at the same instant, their router killed and started again, and
the same without bursts over mutual TLS, with the configuration that `guara security router` writes.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.growth import fit
from benchmarks.machine import machine
from benchmarks.peers import Peer, free_endpoint, free_port, peers
from transport.security.folder import CONFIGURATION
from transport.security.router_folder import make_router

SIZES = (1, 5, 20, 50, 100)
# Robots, or planners, of one process.
HELD = 10
# Between two pauses of a robot [s], and how long nobody publishes while the idle processor time is measured [s].
PERIOD, IDLE = 3.0, 6.0
# Robots of the comparison with TLS and of the router's restart.
COMPARED = 20
# Limits with the largest fleet, met at the limit itself: the longest delay, and the 99th percentile of delays [ms].
WORST_MS, HIGH_MS = 100.0, 50.0
EXTENTS = ("footprint", "map")
TICKS = os.sysconf("SC_CLK_TCK")


class Fleet:
    """A router, robots and planners that run, ready for a measurement."""

    def __init__(
        self, stack: ExitStack, size: int, keys: Path | None = None, *, wait_ms: str = "", held: int = HELD
    ) -> None:
        """Start all.

        Args:
            stack: ends them.
            size: number of robots.
            keys: an empty folder, which gets the keys of mutual TLS; None = plain TCP.
            wait_ms: how long the router waits for a link before it drops a message [ms]; empty: as
                `guara security router` has it. Only without `keys`.
            held: robots of one process.

        Raises:
            ValueError: `wait_ms` with `keys`, whose router is configured by its own file.
        """
        if keys is not None and wait_ms:
            raise ValueError(f"wait_ms {wait_ms} with keys; allowed: without keys, as their router has its own file")
        self.names = [f"r{number}" for number in range(size)]
        self._start = stack.enter_context(peers())
        self._router_arguments = ["router", free_endpoint(), wait_ms]
        endpoint, folder = self._router_arguments[1], ""
        if keys is not None:
            port = free_port()
            made = make_router(keys / "keys", self.names, listen=f"tls/127.0.0.1:{port}")
            endpoint, folder = f"tls/localhost:{port}", str(keys / "keys")
            self._router_arguments = ["zenohd", str(made / CONFIGURATION), ""]
        self.router = self._peer(*self._router_arguments)
        groups = [self.names[first : first + held] for first in range(0, size, held)]
        self.robots = [self._peer("robots", endpoint, folder, *group) for group in groups]
        self.planners = [self._peer("planners", endpoint, folder, *group) for group in groups]

    def _peer(self, *arguments: str) -> Peer:
        peer: Peer = self._start(*arguments, module="fleet_peer")
        return peer

    def publish(self, **command: Any) -> int:
        """Let all robots publish, and return the number of pauses.

        Args:
            command: `once=True`, or `seconds` and `period`, for `Robots.run` of `fleet_peer`.
        """
        for peer in self.robots:
            peer.tell(**command)
        return sum(int(peer.hear()["published"]) for peer in self.robots)

    def reports(self) -> list[dict[str, Any]]:
        """What arrived at the planners since the last call, one report per process."""
        for peer in self.planners:
            peer.tell()
        return [peer.hear() for peer in self.planners]

    def restart_router(self) -> float:
        """Publish while the router is away, and start it again; returns when it was ready [s since the epoch]."""
        self.router.end()
        self.publish(once=True)
        self.router = self._peer(*self._router_arguments)
        return time.time()


def processor_seconds(peer: Peer) -> float:
    """Processor time that a process has used [s]."""
    # After the name in parentheses; utime and stime are fields 14 and 15 of proc(5), which counts from 1.
    fields = Path(f"/proc/{peer.popen.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS


def memory_mb(peer: Peer) -> float:
    """Memory that a process has in use [MB]."""
    lines = Path(f"/proc/{peer.popen.pid}/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmRSS")) / 1e3


def measure(fleet: Fleet, seconds: float) -> dict[str, Any]:
    """Figures of one fleet."""
    size = len(fleet.names)
    # Whatever is done only once falls into a first pause, which is not measured.
    fleet.publish(once=True)
    time.sleep(1.0)
    first = fleet.reports()
    counted = {name: sum(report[name] for report in first) for name in ("missed", "fetched")}
    roles = {"router": [fleet.router], "robot": fleet.robots, "planner": fleet.planners}

    def used() -> dict[str, float]:
        return {role: sum(map(processor_seconds, group)) for role, group in roles.items()}

    before = used()
    time.sleep(IDLE)
    # Share of one core that each role takes while nobody publishes.
    idle = {role: (seconds_then - before[role]) / IDLE for role, seconds_then in used().items()}
    before = used()
    start = time.monotonic()
    pauses = fleet.publish(seconds=seconds, period=PERIOD)
    # A receiver that notices a missing grid fetches it within a second.
    time.sleep(2.0)
    took = time.monotonic() - start
    spent = {role: seconds_then - before[role] for role, seconds_then in used().items()}
    reports = fleet.reports()
    figures: dict[str, Any] = {"robots": size, "pauses": pauses}
    for extent in EXTENTS:
        delays = [delay for report in reports for delay in report["delays_ms"][extent]]
        median, high = np.percentile(delays, (50, 99)) if delays else (np.inf, np.inf)
        figures |= {
            f"{extent}_p50_ms": round(float(median), 1),
            f"{extent}_p99_ms": round(float(high), 1),
            f"{extent}_worst_ms": round(max(delays, default=np.inf), 1),
            f"{extent}_arrived": len(delays),
        }
    for name in ("missed", "fetched"):
        figures[name] = sum(report[name] for report in reports) - counted[name]
    figures["mb_per_s"] = round(sum(report["bytes"] for report in reports) / 1e6 / seconds, 2)
    for role, count in (("router", 1), ("robot", size), ("planner", size)):
        # Per cent of one core, for each robot or planner.
        figures[f"{role}_processor"] = round(100 * spent[role] / took / count, 3)
        figures[f"{role}_idle_ms_per_s"] = round(1e3 * idle[role] / size, 2)
        figures[f"{role}_ms_per_pause"] = round(1e3 * (spent[role] - idle[role] * took) / pauses, 2)
        figures[f"{role}_mb"] = round(sum(map(memory_mb, roles[role])) / len(roles[role]), 1)
    figures["processor"] = round(100 * sum(spent.values()) / took, 2)
    figures["machine_busy"] = round(figures["processor"] / (os.cpu_count() or 1), 1)
    return figures


def bursts(fleet: Fleet, count: int) -> dict[str, Any]:
    """All robots publish at the same instant, `count` times."""
    first = fleet.reports()
    for _ in range(count):
        fleet.publish(once=True)
        time.sleep(PERIOD)
    reports = fleet.reports()
    figures: dict[str, Any] = {"robots": len(fleet.names), "bursts": count}
    for extent in EXTENTS:
        delays = [delay for report in reports for delay in report["delays_ms"][extent]]
        figures[f"{extent}_arrived"] = len(delays)
        figures[f"{extent}_p99_ms"] = round(float(np.percentile(delays, 99)), 1) if delays else None
        figures[f"{extent}_worst_ms"] = round(max(delays), 1) if delays else None
    for name in ("missed", "fetched"):
        figures[name] = sum(report[name] for report in reports) - sum(report[name] for report in first)
    return figures


def storm(fleet: Fleet) -> dict[str, Any]:
    """Restart the router, to which all robots and planners come back at once: when each planner had the newest map."""
    fleet.reports()
    ready = fleet.restart_router()
    came: dict[str, float] = {}
    deadline = time.monotonic() + 30.0
    while len(came) < len(fleet.names) and time.monotonic() < deadline:
        time.sleep(0.2)
        for report in fleet.reports():
            came |= report["newest"]
    after = [arrival - ready for arrival in came.values()]
    return {
        "robots": len(fleet.names),
        "came": len(came),
        "newest_p50_s": round(float(np.median(after)), 2) if after else None,
        "newest_worst_s": round(max(after), 2) if after else None,
    }


def exponents(rows: list[dict[str, Any]]) -> dict[str, float]:
    """Exponents of power laws over the number of robots, fitted to the figures of fleets of five robots or more.

    Returns:
        Exponent by figure; empty with fewer than two such fleets.
    """
    large = [row for row in rows if row["robots"] >= 5]
    if len(large) < 2:
        return {}
    sizes = [row["robots"] for row in large]
    names = ("processor", "router_processor", "footprint_p99_ms", "map_p50_ms", "map_p99_ms", "mb_per_s")
    return {name: round(fit(sizes, [max(row[name], 1e-3) for row in large]), 2) for name in names}


def show(name: str, row: dict[str, Any]) -> None:
    """One line of the table."""
    delays = [row[f"{extent}_{statistic}_ms"] for extent in EXTENTS for statistic in ("p50", "p99", "worst")]
    widths = (15, 8, 8, 9, 8, 8)
    print(
        f"{name:<10}{row['pauses']:>7}"
        + "".join(f"{delay:>{width}.1f}" for delay, width in zip(delays, widths, strict=True))
        + f"{row['missed']:>7}{row['fetched']:>8}{row['mb_per_s']:>7.1f}{row['router_processor']:>8.2f}"
        + f"{row['robot_processor']:>7.2f}{row['planner_processor']:>8.2f}"
        + f"{row['router_mb']:>8.0f}{row['robot_mb']:>8.0f}{row['planner_mb']:>9.0f}",
        flush=True,
    )
    idle, pause = (
        " / ".join(f"{row[f'{role}_{figure}']:g}" for role in ("router", "robot", "planner"))
        for figure in ("idle_ms_per_s", "ms_per_pause")
    )
    print(
        f"  router / robot / planner: {idle} ms a second idle for each robot, {pause} ms for a pause; together "
        f"{row['machine_busy']:g} % of the machine",
        flush=True,
    )


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", default=",".join(map(str, SIZES)), help="numbers of robots")
    parser.add_argument("--seconds", type=float, default=15.0, help="each fleet publishes for this long; at most 60")
    parser.add_argument(
        "--held", type=int, default=HELD, help="robots, or planners, of one process; 1 takes 65 MB each"
    )
    parser.add_argument("--bursts", type=int, default=5, help="how often 20 robots publish at once; at most 50")
    parser.add_argument(
        "--wait-ms",
        default="",
        help="over TCP: how long the router waits for a link [ms]; default: as `guara security router` has it",
    )
    parser.add_argument("--json", action="store_true", help="print all figures as one JSON object in the last line")
    options = parser.parse_args()
    seconds = min(max(options.seconds, 1.0), 60.0)
    rows = []
    held = min(max(options.held, 1), 100)
    figures: dict[str, Any] = {"machine": machine(), "held_by_a_process": held, "period_s": PERIOD}
    print("[ms, MB/s, % of a core of each, MB of a process]")
    print(
        f"{'robots':<10}{'pauses':>7}{'footprint p50':>15}{'p99':>8}{'worst':>8}{'map p50':>9}{'p99':>8}{'worst':>8}"
        f"{'missed':>7}{'fetched':>8}{'MB/s':>7}{'router':>8}{'robot':>7}{'planner':>8}{'router':>8}{'robots':>8}{'planners':>9}"
    )
    for size in map(int, options.sizes.split(",")):
        with ExitStack() as stack:
            rows.append(measure(Fleet(stack, size, wait_ms=options.wait_ms, held=held), seconds))
        show(str(size), rows[-1])
    figures["fleets"] = rows
    figures["exponents"] = exponents(rows)
    if figures["exponents"]:
        print("exponents: " + ", ".join(f"{name} {value:g}" for name, value in figures["exponents"].items()))
    with ExitStack() as stack:
        plain = Fleet(stack, COMPARED, wait_ms=options.wait_ms, held=held)
        figures["tcp"] = measure(plain, seconds)
        show(f"{COMPARED} tcp", figures["tcp"])
        figures["bursts"] = row = bursts(plain, min(max(options.bursts, 1), 50))
        print(
            f"bursts: {row['map_arrived']} of {COMPARED * row['bursts']} maps, 99th percentile {row['map_p99_ms']} ms, "
            f"worst {row['map_worst_ms']} ms; {row['fetched']} grids did not arrive at first and were fetched"
        )
        figures["storm"] = storm(plain)
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        secured = Fleet(stack, COMPARED, folder, held=held)
        figures["tls"] = measure(secured, seconds)
        show(f"{COMPARED} tls", figures["tls"])
        figures["storm_tls"] = storm(secured)
    for name in ("storm", "storm_tls"):
        row = figures[name]
        print(
            f"{name}: {row['came']} of {row['robots']} planners had the newest grid, half of them "
            f"{row['newest_p50_s']} s and the last {row['newest_worst_s']} s after the router was back"
        )
    largest = max(rows, key=lambda row: int(row["robots"]))
    is_met = all(
        largest[f"{extent}_p99_ms"] <= HIGH_MS and largest[f"{extent}_worst_ms"] <= WORST_MS for extent in EXTENTS
    )
    print(
        f"{'ok  ' if is_met else 'FAIL'} with {largest['robots']} robots: the newest of each within {HIGH_MS:g} ms at "
        f"the 99th percentile, {WORST_MS:g} ms at worst"
    )
    if options.json:
        print(json.dumps(figures))
    sys.exit(not is_met)


if __name__ == "__main__":
    main()
