"""How long a grid takes between processes, beside pings of the same bytes over TCP and through shared memory."""

from __future__ import annotations

import multiprocessing
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection
from multiprocessing.shared_memory import SharedMemory

import numpy as np

import transport
from benchmarks.peers import Peer, free_endpoint, free_port, peers
from benchmarks.rounds import Ratio, number
from benchmarks.section import Effort, Section
from benchmarks.transport_peer import make_terrain
from guara_perception.arrays import Codes

TRANSPORT, TCP, SHARED = "publish to receive, array to array", "raw TCP ping", "shared-memory ping"
PERIOD_S = 0.01
ROUNDS = 5


def messaging(effort: Effort) -> Section:
    """Time of a grid one way with encoding and decoding, and of pings there and back with the bytes alone."""
    payload = bytes(transport.encode_terrain(make_terrain(1)))
    per_round = max(effort.pings // ROUNDS, 1)
    seconds: dict[str, list[float]] = {TRANSPORT: [], TCP: [], SHARED: []}
    medians: dict[str, list[float]] = {TRANSPORT: [], TCP: [], SHARED: []}
    with peers() as start, _shared_echo(payload) as ping_memory:
        endpoint, port = free_endpoint(), free_port()
        node, planner = start("node", endpoint, "listen"), start("planner", endpoint, "0")
        start("tcp", str(port))
        with socket.create_connection(("127.0.0.1", port)) as connection:
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            node.tell(publish=0)
            time.sleep(0.5)
            for round_number in range(ROUNDS):
                for name, times in (
                    (TRANSPORT, _publish(node, planner, round_number, per_round)),
                    (TCP, [_ping_tcp(connection, payload) for _ in range(per_round)]),
                    (SHARED, [ping_memory() for _ in range(per_round)]),
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
        "The pings carry the same bytes there and back, without making or reading them. Wall time; ratio of medians in "
        f"each of {ROUNDS} rounds.",
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


@contextmanager
def _shared_echo(payload: bytes) -> Iterator:
    """Start a process that copies one block of shared memory into another; yields the function that pings it."""
    context = multiprocessing.get_context("spawn")
    near, far = context.Pipe()
    there, back = (SharedMemory(create=True, size=len(payload)) for _ in range(2))
    process = context.Process(target=echo, args=(far, there.name, back.name, len(payload)), daemon=True)
    process.start()
    near.recv_bytes()
    source, target = np.frombuffer(payload, np.uint8), np.empty(len(payload), np.uint8)

    def ping() -> float:
        time.sleep(PERIOD_S)
        start = time.monotonic()
        np.copyto(_bytes_of(there)[: len(payload)], source)
        near.send_bytes(b"1")
        near.recv_bytes()
        np.copyto(target, _bytes_of(back)[: len(payload)])
        return time.monotonic() - start

    try:
        yield ping
    finally:
        near.close()
        process.join(10)
        for block in (there, back):
            block.close()
            block.unlink()


def _bytes_of(block: SharedMemory) -> Codes:
    return np.ndarray(block.size, np.uint8, block.buf)


def echo(connection: Connection, source: str, target: str, size: int) -> None:
    """The other process: copies the block into an array of its own and back, each time it gets a byte."""
    there, back = SharedMemory(source), SharedMemory(target)
    own = np.empty(size, np.uint8)
    connection.send_bytes(b"1")
    try:
        while connection.recv_bytes():
            np.copyto(own, _bytes_of(there)[:size])
            np.copyto(_bytes_of(back)[:size], own)
            connection.send_bytes(b"1")
    except EOFError:
        there.close()
        back.close()
