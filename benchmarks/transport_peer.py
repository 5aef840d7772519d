"""Processes that `benchmarks/transport.py` starts: a node, a router, planners, and a raw TCP receiver."""

from __future__ import annotations

import dataclasses
import json
import signal
import socket
import sys
import threading
import time
from typing import Any

import numpy as np

import transport
from transport import keys

SHAPE = (108, 90)


def make_terrain(sequence: int, shape: tuple[int, int] = SHAPE) -> transport.TerrainMessage:
    """A grid with all layers; `variance` holds the sequence number, so that a mixture of two grids would show."""
    rng = np.random.default_rng(sequence)
    layers: dict[str, Any] = {}
    for name, kind in transport.LAYERS.items():
        values = rng.random(shape) if kind.dtype == np.float32 else rng.integers(0, 256, shape)
        layers[name] = values.astype(kind.dtype)
    layers["variance"][:] = sequence
    now = time.time_ns()
    return transport.TerrainMessage(
        robot="guara",
        extent="footprint",
        sequence=sequence,
        step=sequence,
        stamp=now,
        scan_start=now,
        scan_end=now,
        valid_for=1e9,
        valid_pauses=1000,
        mode="standard",
        method="precise",
        calibration_hash="0" * 64,
        resolution=0.005,
        origin=(0.5, -0.27),
        layers=layers,
        stance=transport.StanceMessage(
            joint_positions={f"joint_{i}": 0.1 * i for i in range(16)},
            support_feet=("lf", "rf", "lh", "rh"),
            gravity_in_base=(0.0, 0.0, -1.0),
        ),
        attitude_source="imu",
        transforms=(
            transport.TransformMessage(
                source_frame="base_link", destination_frame="base_footprint", matrix=np.eye(4), covariance=np.eye(6)
            ),
        ),
        point_counts={"in": 70000, "used": 69000, "dropout": 1000},
        stage_ms={"stripes": 100.0, "finish": 20.0},
        coverage=0.98,
    )


def is_whole(terrain: transport.TerrainMessage) -> bool:
    """Whether every cell of `variance` holds the message's own sequence number."""
    return bool(np.all(terrain.layers["variance"] == terrain.sequence))


def say(**reply: Any) -> None:
    """A line of JSON to the benchmark."""
    print(json.dumps(reply), flush=True)


def run_router(endpoint: str) -> None:
    """A Zenoh router and nothing else."""
    with transport.open_node(listen=endpoint):
        say(ready=True)
        sys.stdin.read()


def run_node(endpoint: str, mode: str) -> None:
    """A node; takes {"publish": n} and {"stream": n, "period": s, "rows": n}."""
    session = (
        transport.open_node(listen=endpoint)
        if mode == "listen"
        else transport.open_node(connect=endpoint, timeout=30.0)
    )
    with session:
        outbox = transport.Outbox()
        publisher = transport.Publisher(session, keys.terrain_key())
        token = transport.AliveToken(session, keys.alive_key())
        say(ready=True)
        for line in sys.stdin:
            command = json.loads(line)
            if "publish" in command:
                publisher.put(transport.encode_terrain(make_terrain(command["publish"])))
            else:
                _stream(publisher, outbox, command)
        outbox.close()
        token.close()


def _stream(publisher: transport.Publisher, outbox: transport.Outbox, command: dict[str, Any]) -> None:
    shape = (int(command["rows"]), 400) if command.get("rows") else SHAPE
    templates = [make_terrain(n, shape) for n in range(1, min(command["stream"], 20) + 1)]
    # The number goes into the step, so that many grids share the arrays of few.
    grids = [dataclasses.replace(templates[n % len(templates)], step=n + 1) for n in range(command["stream"])]
    times: dict[int, int] = {}

    for grid in grids[command.get("first", 1) - 1 :]:
        times[grid.step] = time.monotonic_ns()
        outbox.post("grid", lambda grid=grid: publisher.put(transport.encode_terrain(grid)))  # type: ignore[misc]
        if command["period"]:
            time.sleep(command["period"])
        else:
            outbox.flush(60.0)
    outbox.flush(60.0)
    say(streamed=command["stream"], times=times, longest_ms=1e3 * outbox.longest, superseded=outbox.superseded)


def run_planner(endpoint: str, period: str) -> None:
    """A planner that takes the newest grid every `period` seconds (0: each one); reports when it got each."""
    got: dict[int, int] = {}
    whole = True
    session = transport.open_client(endpoint, timeout=30.0)
    client = transport.PerceptionClient(session)
    receiver = client.receiver()
    stop = threading.Event()

    def take(terrain: transport.TerrainMessage) -> None:
        nonlocal whole
        got.setdefault(terrain.step, time.monotonic_ns())
        whole = whole and is_whole(terrain)

    if float(period) == 0.0:
        client.on_terrain(take)
    say(ready=True)
    if float(period) > 0.0:
        taker = threading.Thread(target=_take_slowly, args=(client, float(period), take, stop))
        taker.start()
    for _ in sys.stdin:
        say(got=got, whole=whole, received=receiver.received, missed=receiver.missed, superseded=receiver.superseded)
    stop.set()
    client.close()


def _take_slowly(client: transport.PerceptionClient, period: float, take: Any, stop: threading.Event) -> None:
    while not stop.wait(period):
        received = client.receiver().latest()
        if received is not None:
            take(received.message)


def run_tcp(port: str) -> None:
    """Receives blocks over raw TCP into arrays and sends them back; reports when each had arrived."""
    got: list[int] = []
    with socket.create_server(("127.0.0.1", int(port))) as server:
        say(ready=True)
        connection, _ = server.accept()
        with connection:
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            while header := connection.recv(8, socket.MSG_WAITALL):
                buffer = bytearray(int.from_bytes(header, "little"))
                view, done = memoryview(buffer), 0
                while done < len(buffer):
                    done += connection.recv_into(view[done:])
                got.append(time.monotonic_ns())
                connection.sendall(buffer)
            say(got=got)


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    commands: dict[str, Any] = {"router": run_router, "node": run_node, "planner": run_planner, "tcp": run_tcp}
    commands[sys.argv[1]](*sys.argv[2:])
