"""The transport: messages beside raw TCP, faults with real processes, slow viewers, floods, many robots, encodings.

`python -m benchmarks transport PART ...`; without a part: a list of them. `--quick` takes a tenth of the counts of
`messages`.
"""

from __future__ import annotations

import argparse
import signal
import socket
import statistics
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

import transport
from benchmarks import announcements, compact, fleet, viewers
from benchmarks.command import run_part
from benchmarks.peers import PATIENCE, Peer, free_endpoint, free_port, peers
from benchmarks.report import to_terminal
from benchmarks.rounds import Ratio, number
from benchmarks.section import FULL, QUICK, Effort, Section
from testbed.slow_link import SlowLink
from testbed.terrain_message import make_terrain
from transport import keys

TRANSPORT, TCP = "publish to receive, array to array", "raw TCP ping"
PERIOD_S = 0.01
ROUNDS = 5


@contextmanager
def node_and_planners(*periods: str) -> Iterator[tuple[Peer, list[Peer]]]:
    """A node, and planners that take grids at these periods."""
    with peers() as start:
        endpoint = free_endpoint()
        node = start("node", endpoint, "listen")
        planners = [start("planner", endpoint, period) for period in periods]
        # Until the node knows of its planners.
        time.sleep(0.5)
        yield node, planners


def messaging(effort: Effort) -> Section:
    """Time of a grid one way with encoding and decoding, and of pings there and back with the bytes alone."""
    payload = bytes(transport.encode_terrain(make_terrain(1)))
    per_round = max(effort.pings // ROUNDS, 1)
    seconds: dict[str, list[float]] = {TRANSPORT: [], TCP: []}
    medians: dict[str, list[float]] = {TRANSPORT: [], TCP: []}
    port = free_port()
    with peers() as start, node_and_planners("0") as (node, (planner,)):
        start("tcp", str(port))
        with socket.create_connection(("127.0.0.1", port)) as connection:
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            for round_number in range(ROUNDS):
                for name, times in (
                    (TRANSPORT, _publish(node, planner, round_number, per_round)),
                    (TCP, [_ping_tcp(connection, payload) for _ in range(per_round)]),
                ):
                    seconds[name] += times
                    medians[name].append(float(np.median(times)))
    rows: list[tuple[str, ...]] = []
    figures: dict[str, dict[str, float]] = {}
    for name, times in seconds.items():
        ratios = np.array(medians[name]) / medians[TCP]
        ratio = Ratio(float(np.median(ratios)), float(ratios.min()), float(ratios.max()))
        p50, p99 = (1e3 * float(np.percentile(times, percent)) for percent in (50, 99))
        figures[name] = {"ratio": ratio.median, "p50_ms": p50, "p99_ms": p99}
        rows.append((name, number(p50), number(p99), str(ratio)))
    return Section(
        "messaging",
        "Grids between processes",
        f"One grid of 108 x 90 cells with all layers ({len(payload) / 1e3:.0f} kB) from one process to another on the "
        "same machine. Publish to receive: from the arrays of the node to those of the planner, one way, over Zenoh. "
        "The ping carries the same bytes there and back, without making or reading them. Wall time; ratio of medians "
        f"in each of {ROUNDS} rounds.",
        ("by", "p50 ms", "p99 ms", "x raw TCP ping"),
        rows,
        figures,
    )


def _publish(node: Peer, planner: Peer, round_number: int, count: int) -> list[float]:
    node.tell(stream=count * (round_number + 1), first=count * round_number + 1, period=PERIOD_S)
    sent = node.hear()["times"]
    deadline = time.monotonic() + 10
    while True:
        planner.tell()
        got = planner.hear()["got"]
        # The newest replaces those not yet taken: under load some never arrive, the last one always does.
        if str(count * (round_number + 1)) in got or time.monotonic() > deadline:
            return [(got[step] - begin) * 1e-9 for step, begin in sent.items() if step in got]


def _ping_tcp(connection: socket.socket, payload: bytes) -> float:
    time.sleep(PERIOD_S)
    back = bytearray(len(payload))
    start = time.monotonic()
    connection.sendall(len(payload).to_bytes(8, "little") + payload)
    connection.recv_into(back, len(back), socket.MSG_WAITALL)
    return time.monotonic() - start


def report(what: str, measured: str, allowed: str, is_met: bool) -> None:
    """One line of the table."""
    print(f"{'ok  ' if is_met else 'MISS'}  {what:<58} {measured:<44} {allowed}", flush=True)


def router_kills(count: int) -> None:
    """The router is killed; two grids are published while it is dead; it comes back."""
    times = []
    with peers() as start:
        endpoint = free_endpoint()
        router = start("router", endpoint)
        node = start("node", endpoint, "connect")
        with transport.PerceptionClient(transport.open_client(endpoint, timeout=PATIENCE)) as client:
            node.tell(publish=1)
            client.receive(lambda grid: grid.sequence == 1, timeout=PATIENCE)
            for kill in range(count):
                router.end()
                newest = 10 * (kill + 1)
                node.tell(publish=newest - 1)
                node.tell(publish=newest)
                time.sleep(1.0)
                # From the start of the process: its imports are counted too.
                begin = time.monotonic()
                router = start("router", endpoint)
                client.receive(lambda grid, n=newest: grid.sequence == n, timeout=PATIENCE)  # type: ignore[misc]
                times.append(time.monotonic() - begin)
    measured = f"slowest {max(times):.2f} s, p50 {statistics.median(times):.2f} s"
    report(f"{count} router kills: newest grid after its start", measured, "<= 2 s", max(times) <= 2.0)


def stopped_planner(seconds: float) -> None:
    """One planner is stopped while the node publishes at 20 Hz; another goes on."""
    count = int(20 * seconds)
    with node_and_planners("0", "0") as (node, (healthy, stuck)):
        stuck.popen.send_signal(signal.SIGSTOP)
        node.tell(stream=count, period=0.05)
        longest = node.hear()["longest_ms"]
        time.sleep(1.0)
        healthy.tell()
        lost = count - healthy.hear()["received"]
    measured = f"lost {lost} of {count}, longest put {longest:.1f} ms"
    what = f"planner stopped for {seconds:g} s: the other one, put"
    report(what, measured, "lost 0, <= 50 ms", lost == 0 and longest <= 50.0)


def slow_planner(seconds: float) -> None:
    """A planner that takes a grid every 250 ms, while the node publishes at 20 Hz."""
    # No multiple of the period of 50 ms, so that grids are taken at every age.
    with node_and_planners("0.257") as (node, (slow,)):
        node.tell(stream=int(20 * seconds), period=0.05)
        times = node.hear()["times"]
        slow.tell()
        heard = slow.hear()
    ages = [(got - times[k]) / 1e6 for k, got in heard["got"].items() if k in times]
    # A grid is replaced one period after it was made, plus the transfer of its successor.
    measured = f"p50 {statistics.median(ages):.0f}, oldest {max(ages):.0f} ms, superseded {heard['superseded']}"
    report("planner at 250 ms, grids at 20 Hz: age when taken", measured, "<= 50 ms + transfer (10)", max(ages) <= 60.0)


def slow_link(count: int) -> None:
    """Grids of 0.8 MB at 10 Hz over 20 Mbit/s, where one takes 0.3 s, then silence: does the last one arrive?"""
    with peers() as start:
        endpoint = free_endpoint()
        node = start("node", endpoint, "listen")
        with SlowLink(endpoint, 20e6 / 8) as link:
            # Without shared memory, or the payload would not go through the slow link at all.
            session = transport.open_client(link.endpoint, shared_memory=False, timeout=PATIENCE)
            with transport.PerceptionClient(session) as client:
                receiver = client.receiver()
                client.wait_until_alive(PATIENCE)
                node.tell(stream=count, period=0.1, rows=49)
                longest = node.hear()["longest_ms"]
                begin = time.monotonic()
                client.receive(lambda grid: grid.step == count, timeout=PATIENCE)
                seconds = time.monotonic() - begin
                lost = receiver.missed
    measured = f"{seconds:.2f} s after its put, {lost} lost, longest put {longest:.1f} ms"
    report(f"last of {count} grids of 0.8 MB over 20 Mbit/s", measured, "arrives, put <= 50 ms", longest <= 50.0)


def deaths(count: int) -> None:
    """Time until a planner sees that a node was killed, or hangs."""
    for signal_number, limit, outcome in ((signal.SIGKILL, 0.5, "killed"), (signal.SIGSTOP, 2.5, "hung")):
        times = []
        for _ in range(count):
            with peers() as start:
                endpoint = free_endpoint()
                start("router", endpoint)
                node = start("node", endpoint, "connect")
                gone = threading.Event()
                with transport.open_client(endpoint, timeout=PATIENCE) as session:
                    watcher = transport.AliveWatcher(
                        session,
                        keys.alive_key(),
                        lambda alive, gone=gone: None if alive else gone.set(),  # type: ignore[misc]
                    )
                    watcher.wait(True, PATIENCE)
                    begin = time.monotonic()
                    node.popen.send_signal(signal_number)
                    gone.wait(PATIENCE)
                    times.append(time.monotonic() - begin)
        what, measured = f"node {outcome}: seen after", f"slowest {max(times):.2f} s of {count}"
        report(what, measured, f"< {limit} s", max(times) < limit)


def messages() -> None:
    """Latency beside raw TCP, and every fault with real processes [--quick]."""
    parser = argparse.ArgumentParser(description=messages.__doc__)
    parser.add_argument("--quick", action="store_true", help="a tenth of the counts")
    quick = parser.parse_args().quick
    print(to_terminal(messaging(QUICK if quick else FULL)))
    router_kills(1 if quick else 5)
    stopped_planner(2.0 if quick else 10.0)
    slow_planner(3.0 if quick else 10.0)
    slow_link(6 if quick else 20)
    deaths(1 if quick else 5)


def main() -> None:
    """Command line."""
    parts = {
        "messages": messages,
        "viewers": viewers.main,
        "announcements": announcements.main,
        "fleet": fleet.main,
        "compact": compact.main,
    }
    run_part("transport", parts)


if __name__ == "__main__":
    main()
