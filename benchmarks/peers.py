"""Processes that benchmarks start and with which they exchange lines of JSON.

`python -m benchmarks.peers MODULE ROLE ARGUMENT ...` runs one. The module `peers` has a router, a node that
answers scan requests, and a planner that waits for a step.
"""

from __future__ import annotations

import dataclasses
import importlib
import json
import os
import socket
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

import guara_perception as gp
import transport
from guara_perception.simulation.walk import WalkPause, simulate_walk
from guara_perception.simulation.world import World
from kinematics import RobotModel, Stance
from testbed.terrain_message import make_terrain
from transport.configuration import router_configuration
from transport.links.session import listen_with
from transport.security.folder import CONFIGURATION

ROOT = Path(__file__).resolve().parents[1]
SHAPE = (108, 90)
# Longest wait for a process, and of one attempt to get a grid [s].
PATIENCE, ATTEMPT = 60.0, 0.2


class Peer:
    """A process with which lines of JSON are exchanged."""

    def __init__(self, command: list[str], *, cwd: Path = ROOT, **environment: str) -> None:
        """Start it and wait for its first line, which says that it is ready.

        Args:
            command: its command line.
            cwd: its working directory.
            environment: further variables of its environment.
        """
        self.popen = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            cwd=cwd,
            env={**os.environ, **environment},
        )
        self.receive()

    def send(self, **command: Any) -> None:
        """Send a command."""
        assert self.popen.stdin is not None
        self.popen.stdin.write(json.dumps(command) + "\n")
        self.popen.stdin.flush()

    def receive(self) -> dict[str, Any]:
        """Read the next line; empty after the end of the process."""
        assert self.popen.stdout is not None
        return dict(json.loads(self.popen.stdout.readline() or "{}"))

    def follow(self, take: Callable[[dict[str, Any]], object]) -> None:
        """Pass each further line to a function, in a thread."""

        def read() -> None:
            while line := self.receive():
                take(line)

        threading.Thread(target=read, daemon=True).start()

    def end(self) -> None:
        """Kill it."""
        self.popen.kill()
        self.popen.wait()


class Role(Peer):
    """A process that runs the function `run_ROLE` of a module of `benchmarks`."""

    def __init__(self, *arguments: str, module: str = "peers") -> None:
        """Start it; the role is the first argument."""
        super().__init__([sys.executable, "-m", "benchmarks.peers", module, *arguments])


class Child(Role):
    """A process with its last report."""

    def __init__(self, *arguments: str, module: str = "peers") -> None:
        """Start it and wait until it is ready."""
        super().__init__(*arguments, module=module)
        self._last: dict[str, Any] = {}
        self.follow(self._last.update)

    @property
    def counts(self) -> Counter[str]:
        """Counts of its last report."""
        return Counter(self._last.get("counts", {}))


@contextmanager
def peers() -> Iterator[Callable[..., Peer]]:
    """A function that starts processes; all of them are killed at the end."""
    started: list[Peer] = []

    def start(*arguments: str, module: str = "peers") -> Peer:
        started.append(Role(*arguments, module=module))
        return started[-1]

    try:
        yield start
    finally:
        for peer in started:
            peer.end()


def free_port() -> int:
    """Free TCP port of this machine."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def free_endpoint() -> str:
    """Free Zenoh endpoint of this machine."""
    return f"tcp/127.0.0.1:{free_port()}"


class Pauses:
    """Pauses of a simulated node: a footprint's grid, what is derived from it, and a map, all with values of 1."""

    def __init__(self, map_shape: tuple[int, int]) -> None:
        """Make both grids."""
        self._footprint, self._map = make_terrain(1), make_terrain(1, shape=map_shape, extent="map")
        self._occupancy = np.zeros(SHAPE, np.int8)
        self.sizes = {each.extent: len(transport.encode_terrain(each)) for each in (self._footprint, self._map)}

    def publish(self, server: transport.PerceptionServer) -> transport.TerrainMessage:
        """Publish one pause; return the message of the footprint."""
        number = server.next_sequence("footprint")
        changes: dict[str, Any] = {"robot": server.robot, "sequence": number, "step": number}
        made = []
        for grid, occupancy in ((self._footprint, self._occupancy), (self._map, None)):
            now = time.time_ns()
            made.append(dataclasses.replace(grid, stamp=now, scan_start=now, scan_end=now, **changes))
            server.publish(made[-1], occupancy=occupancy)
        return made[0]


def wait_for_map(
    client: gp.TerrainClient, step: int, patience: float, give_up: Callable[[], object], **accepted: Any
) -> gp.TerrainGrid | None:
    """Map of a pause from a node that may restart meanwhile; None after `patience` [s].

    Args:
        client: connected client.
        step: number of the pause.
        patience: longest wait [s].
        give_up: called between attempts; ends the wait if its result is true.
        accepted: keywords of `TerrainClient.wait_for_step`.
    """
    until = time.monotonic() + patience
    while (left := until - time.monotonic()) > 0.0:
        with suppress(gp.StaleTerrain, gp.ScannerUnavailable, gp.ReceiveTimeout, gp.ScannerGone):
            return client.wait_for_step(step, min(left, ATTEMPT), "map", **accepted)
        if give_up():
            break
    return None


def percentiles(values: Sequence[float], *percent: float) -> list[float]:
    """Percentiles of some values; infinite without values."""
    return np.percentile(values, percent).tolist() if values else [np.inf] * len(percent)


def standing(robot: RobotModel, stance: Stance) -> WalkPause:
    """Pause of a robot that stands and has not walked yet, as `SimulatedGait` announces it."""
    return dataclasses.replace(next(simulate_walk(World(), robot, cycles=0)), stance=stance, known_ground=())


def report(**values: Any) -> None:
    """Send a line of JSON to the benchmark."""
    print(json.dumps(values), flush=True)


def ended() -> threading.Event:
    """Event that is set when the standard input is closed."""
    event = threading.Event()

    def listen() -> None:
        sys.stdin.read()
        event.set()

    threading.Thread(target=listen, daemon=True).start()
    return event


def run_router(at: str) -> None:
    """A Zenoh router with the file that `guara security router` wrote, or at an endpoint with the same but TLS."""
    import zenoh

    is_file = at.endswith(CONFIGURATION)
    with zenoh.open(zenoh.Config.from_file(at)) if is_file else listen_with(router_configuration([at]), (at,)):
        report(ready=True)
        sys.stdin.read()


def run_scanner(endpoint: str, mode: str, rows: str, columns: str, security: str = "") -> None:
    """A node that answers scan requests with grids of both extents, the map of this shape."""
    options: dict[str, Any] = {mode: endpoint, "timeout": PATIENCE, "security": security or None}
    pauses = Pauses((int(rows), int(columns)))
    with transport.open_node(**options) as session:
        server = transport.PerceptionServer(session)
        server.serve_scans(lambda _: pauses.publish(server))
        report(ready=True)
        sys.stdin.read()


def run_waiter(endpoint: str) -> None:
    """A planner that waits for the pause of each {"step": n} by `gp.TerrainClient`; reports when it had its grid."""
    with gp.TerrainClient(endpoint, timeout=2 * PATIENCE) as client:
        report(ready=True)
        for line in sys.stdin:
            client.wait_for_step(json.loads(line)["step"], timeout=2 * PATIENCE)
            report(at=time.monotonic())


if __name__ == "__main__":
    name, role, *given = sys.argv[1:]
    getattr(importlib.import_module(f"benchmarks.{name}"), f"run_{role}")(*given)
