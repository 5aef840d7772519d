"""Prints the figures of the transport: latency against raw TCP, codec, and every fault with real processes.

Usage: python -m benchmarks.transport [--quick]
"""

from __future__ import annotations

import argparse
import signal
import socket
import statistics
import threading
import time

import numpy as np

import transport
from benchmarks.damaged_messages import damaged
from benchmarks.peers import free_endpoint, free_port, peers
from benchmarks.transport_peer import is_whole, make_terrain
from testbed.slow_link import SlowLink
from transport import keys

PATIENCE = 60.0


def report(what: str, measured: str, allowed: str, is_met: bool) -> None:
    """One line of the table."""
    print(f"{'ok  ' if is_met else 'MISS'}  {what:<58} {measured:<44} {allowed}", flush=True)


def codec(count: int) -> None:
    """Encode and decode of the 108 x 90 grid with all layers."""
    terrain = make_terrain(1)
    payload = transport.encode_terrain(terrain)
    out, back = [], []
    for _ in range(count):
        start = time.perf_counter()
        payload = transport.encode_terrain(terrain)
        encoded = time.perf_counter()
        transport.decode_terrain(payload)
        out.append(encoded - start)
        back.append(time.perf_counter() - encoded)
    encode_ms, decode_ms = 1e3 * statistics.median(out), 1e3 * statistics.median(back)
    measured = f"{encode_ms:.2f} + {decode_ms:.2f} ms, {len(payload) / 1e3:.0f} kB"
    report("encode + decode, 108 x 90, all layers, p50", measured, "<= 0.5 ms", encode_ms + decode_ms <= 0.5)


def latency(rounds: int, per_round: int) -> None:
    """Array to array between two processes: this project's, and the same bytes over raw TCP, alternating in one run."""
    delays: list[float] = []
    echoes: list[float] = []
    payload = np.frombuffer(transport.encode_terrain(make_terrain(1)), np.uint8)
    with peers() as start:
        endpoint = free_endpoint()
        node = start("node", endpoint, "listen")
        planner = start("planner", endpoint, "0")
        port = free_port()
        tcp = start("tcp", str(port))
        sent: list[int] = []
        with socket.create_connection(("127.0.0.1", port)) as connection:
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            node.tell(publish=0)
            time.sleep(0.5)
            for number in range(rounds):
                for _ in range(per_round):
                    sent.append(time.monotonic_ns())
                    connection.sendall(payload.nbytes.to_bytes(8, "little") + payload.tobytes())
                    connection.recv_into(bytearray(payload.nbytes), payload.nbytes, socket.MSG_WAITALL)
                    echoes.append(time.monotonic_ns() - sent[-1])
                    time.sleep(0.02)
                node.tell(stream=per_round * (number + 1), first=per_round * number + 1, period=0.02)
                times = node.hear()["times"]
                planner.tell()
                got = planner.hear()["got"]
                delays += [got[step] - begin for step, begin in times.items() if step in got]
        one_way = [b - a for a, b in zip(sent, tcp.hear()["got"], strict=True)]
    p50, raw50, echo50 = (statistics.median(times) / 1e6 for times in (delays, one_way, echoes))
    report(
        f"array to array, p50 of {len(delays)}: this project / raw TCP ping, there and back",
        f"{p50:.2f} ms / {echo50:.2f} ms = {p50 / echo50:.2f}",
        "<= 3",
        p50 <= 3.0 * echo50,
    )
    report(
        f"array to array, p50 of {len(delays)}: this project / raw TCP one way",
        f"{p50:.2f} ms / {raw50:.2f} ms = {p50 / raw50:.2f}",
        "<= 3 when the ping is taken one way",
        p50 <= 3.0 * raw50,
    )


def late_joins(count: int) -> None:
    """Clients that come after the last scan."""
    times = []
    with peers() as start:
        endpoint = free_endpoint()
        start("node", endpoint, "listen").tell(publish=7)
        time.sleep(0.5)
        for _ in range(count):
            begin = time.monotonic()
            with transport.PerceptionClient(transport.open_client(endpoint, timeout=PATIENCE)) as client:
                try:
                    found = client.latest().sequence == 7
                except transport.TransportError:
                    found = False
            times.append(time.monotonic() - begin if found else float("inf"))
    served = sum(t <= 1.0 for t in times)
    report(f"{count} late joins: last grid within 1 s", f"{served}, slowest {max(times):.3f} s", "all", served == count)


def router_kills(count: int) -> None:
    """The router is killed; two grids are published while it is dead; it comes back."""
    times = []
    with peers() as start:
        endpoint = free_endpoint()
        router = start("router", endpoint)
        node = start("node", endpoint, "connect")
        with transport.PerceptionClient(transport.open_client(endpoint, timeout=PATIENCE)) as client:
            node.tell(publish=1)
            client.wait_for(lambda grid: grid.sequence == 1, timeout=PATIENCE)
            for number in range(count):
                router.end()
                newest = 10 * (number + 1)
                node.tell(publish=newest - 1)
                node.tell(publish=newest)
                time.sleep(1.0)
                # From the start of the process: its imports are counted too.
                begin = time.monotonic()
                router = start("router", endpoint)
                client.wait_for(lambda grid, n=newest: grid.sequence == n, timeout=PATIENCE)  # type: ignore[misc]
                times.append(time.monotonic() - begin)
    measured = f"slowest {max(times):.2f} s, p50 {statistics.median(times):.2f} s"
    report(f"{count} router kills: newest grid after its start", measured, "<= 2 s", max(times) <= 2.0)


def stopped_planner(seconds: float) -> None:
    """One planner is stopped while the node publishes at 20 Hz; another goes on."""
    with peers() as start:
        endpoint = free_endpoint()
        node = start("node", endpoint, "listen")
        healthy = start("planner", endpoint, "0")
        stuck = start("planner", endpoint, "0")
        node.tell(publish=0)
        time.sleep(0.5)
        stuck.popen.send_signal(signal.SIGSTOP)
        count = int(20 * seconds)
        node.tell(stream=count, period=0.05)
        result = node.hear()
        time.sleep(1.0)
        healthy.tell()
        heard = healthy.hear()
    lost = count + 1 - heard["received"]
    measured = f"lost {lost} of {count}, longest put {result['longest_ms']:.1f} ms"
    report(
        f"planner stopped for {seconds:g} s: the other one, put", measured, "lost 0, <= 50 ms",
        lost == 0 and result["longest_ms"] <= 50.0,
    )  # fmt: skip


def slow_planner(seconds: float) -> None:
    """A planner that takes a grid every 250 ms, while the node publishes at 20 Hz."""
    with peers() as start:
        endpoint = free_endpoint()
        node = start("node", endpoint, "listen")
        # No multiple of the period of 50 ms, so that grids are taken at every age.
        slow = start("planner", endpoint, "0.257")
        count = int(20 * seconds)
        node.tell(publish=0)
        time.sleep(0.5)
        node.tell(stream=count, period=0.05)
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
                result = node.hear()
                begin = time.monotonic()
                client.wait_for(lambda grid: grid.step == count, timeout=PATIENCE)
                seconds = time.monotonic() - begin
                lost = receiver.missed
    measured = f"{seconds:.2f} s after its put, {lost} lost, longest put {result['longest_ms']:.1f} ms"
    report(
        f"last of {count} grids of 0.8 MB over 20 Mbit/s",
        measured,
        "arrives, put <= 50 ms",
        result["longest_ms"] <= 50.0,
    )


def killed_nodes(count: int) -> None:
    """Nodes are killed with -9 while they put 5 MB grids one after another."""
    whole: list[bool] = []
    endpoint = free_endpoint()
    with peers() as start:
        start("router", endpoint)
        with transport.open_client(endpoint, timeout=PATIENCE) as session:
            receiver = transport.NewestReceiver(session, keys.terrain_key(), transport.decode_terrain)
            receiver.on_newest(lambda received: whole.append(is_whole(received.message)))
            rng = np.random.default_rng(0)
            for _ in range(count):
                node = start("node", endpoint, "connect")
                before = receiver.received
                node.tell(stream=20, period=0.0, rows=310)
                deadline = time.monotonic() + PATIENCE
                while receiver.received == before and time.monotonic() < deadline:
                    time.sleep(0.001)
                time.sleep(float(rng.uniform(0.0, 0.05)))
                node.end()
            received, rejected = receiver.received, receiver.rejected
    measured = f"{received} received, {rejected} damaged, {whole.count(False)} mixed"
    met = rejected == 0 and all(whole) and received >= count
    report(f"{count} kill -9 during puts of 5 MB", measured, "no partial grid", met)


def deaths(count: int) -> None:
    """How soon a planner sees that a node was killed, or hangs."""
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
        report(
            f"node {outcome}: seen after", f"slowest {max(times):.2f} s of {count}", f"< {limit} s", max(times) < limit
        )


def main() -> None:
    """Run all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a tenth of the counts")
    quick = parser.parse_args().quick
    codec(50 if quick else 500)
    latency(2 if quick else 5, 20 if quick else 60)
    late_joins(5 if quick else 30)
    router_kills(1 if quick else 5)
    stopped_planner(2.0 if quick else 10.0)
    slow_planner(3.0 if quick else 10.0)
    slow_link(6 if quick else 20)
    deaths(1 if quick else 5)
    killed_nodes(3 if quick else 50)
    for line in damaged(500 if quick else 10_000):
        report(*line)


if __name__ == "__main__":
    main()
