"""Processes that `benchmarks/fleet.py` starts: a router, several robots, several planners."""

from __future__ import annotations

import dataclasses
import json
import random
import sys
import threading
import time
from typing import Any

import numpy as np

import transport
from benchmarks.transport_peer import SHAPE, make_terrain, say
from transport.configuration import router_configuration
from transport.session import listen_with

# Cells of the fused map as a robot publishes it: 1.8 MB with all layers.
MAP_SHAPE = (140, 320)
PATIENCE = 60.0


def run_router(endpoint: str, wait_ms: str) -> None:
    """A Zenoh router as `guara security router` configures it, but without TLS; `wait_ms` replaces its own wait."""
    configuration = router_configuration([endpoint])
    if wait_ms:
        drop = configuration["transport"]["link"]["tx"]["queue"]["congestion_control"]["drop"]
        drop["max_wait_before_drop_fragments"] = 1000 * int(wait_ms)
    with listen_with(configuration, (endpoint,)):
        say(ready=True)
        sys.stdin.read()


def run_zenohd(configuration: str, _: str) -> None:
    """A Zenoh router with the configuration file that `guara security router` wrote."""
    import zenoh

    with zenoh.open(zenoh.Config.from_file(configuration)):
        say(ready=True)
        sys.stdin.read()


class Robots:
    """Robots of one process, each with a Zenoh session of its own; one thread publishes for all of them."""

    def __init__(self, names: list[str], endpoint: str, security: str) -> None:
        """Connect each; `security` is a folder with one folder per robot, or empty for plain TCP."""
        self._footprint = make_terrain(1)
        self._map = dataclasses.replace(make_terrain(1, MAP_SHAPE), extent="map")
        self._occupancy = np.zeros(SHAPE, np.int8)
        self._servers = []
        for name in names:
            folder = f"{security}/{name}" if security else None
            session = transport.open_node(connect=endpoint, security=folder, timeout=PATIENCE)
            self._servers.append(transport.PerceptionServer(session, robot=name, name_timeout=PATIENCE))

    def publish(self, server: transport.PerceptionServer) -> None:
        """One pause: footprint, what is derived from it, map."""
        now, number = time.time_ns(), server.next_sequence("footprint")
        changes: dict[str, Any] = {
            "robot": server.robot,
            "sequence": number,
            "step": number,
            "stamp": now,
            "scan_start": now,
            "scan_end": now,
        }
        server.publish(dataclasses.replace(self._footprint, **changes), occupancy=self._occupancy)
        now = time.time_ns()
        server.publish(dataclasses.replace(self._map, **changes | {"scan_end": now}))

    def run(self, seconds: float, period: float) -> int:
        """Publish for this long, each robot every `period` from a random phase on; returns the number of pauses."""
        chance = random.Random()
        start = time.monotonic()
        due = [(start + chance.random() * period, server) for server in self._servers]
        count = 0
        while due:
            due_at, server = min(due, key=lambda entry: entry[0])
            due.remove((due_at, server))
            if due_at > start + seconds:
                continue
            time.sleep(max(0.0, due_at - time.monotonic()))
            self.publish(server)
            count += 1
            due.append((due_at + period, server))
        for server in self._servers:
            server.flush(PATIENCE)
        return count

    def publish_all(self) -> None:
        """One pause of each, at once."""
        for server in self._servers:
            self.publish(server)


def run_robots(endpoint: str, security: str, *names: str) -> None:
    """Robots; each line of the standard input says for how long and how often to publish, or to publish once."""
    robots = Robots(list(names), endpoint, security)
    say(ready=True)
    for line in sys.stdin:
        command = json.loads(line)
        if command.get("once"):
            robots.publish_all()
            say(published=len(names))
        else:
            say(published=robots.run(command["seconds"], command["period"]))


class Planners:
    """Planners of one process, each with a client of its own robot."""

    def __init__(self, names: list[str], endpoint: str, security: str) -> None:
        """Connect each; `security` is a folder with one folder per robot, or empty for plain TCP."""
        self._lock = threading.Lock()
        self._delays: dict[str, list[float]] = {"footprint": [], "map": []}
        self._bytes = 0
        self._newest: dict[str, float] = {}
        self._clients = []
        sizes = {
            "footprint": len(transport.encode_terrain(make_terrain(1))),
            "map": len(transport.encode_terrain(dataclasses.replace(make_terrain(1, MAP_SHAPE), extent="map"))),
        }
        for name in names:
            folder = f"{security}/{name}/planner" if security else None
            session = transport.open_client(endpoint, security=folder, timeout=PATIENCE)
            client = transport.PerceptionClient(session, robot=name)
            for extent in ("footprint", "map"):
                client.receiver(extent).on_newest(
                    lambda received, size=sizes[extent]: self._take(received.message, size)  # type: ignore[misc]
                )
            self._clients.append(client)

    def _take(self, terrain: transport.TerrainMessage, size: int) -> None:
        now = time.time_ns()
        with self._lock:
            self._delays[terrain.extent].append((now - terrain.scan_end) * 1e-6)
            self._bytes += size
            self._newest[terrain.robot] = now * 1e-9

    def report(self) -> dict[str, Any]:
        """Delays, bytes and newest instants since the last report; counts of grids not received, since the start."""
        receivers = [client.receiver(extent) for client in self._clients for extent in ("footprint", "map")]
        with self._lock:
            report = {
                "delays_ms": self._delays,
                "bytes": self._bytes,
                "newest": self._newest,
                "missed": sum(receiver.missed for receiver in receivers),
                "fetched": sum(receiver.fetched for receiver in receivers),
                "superseded": sum(receiver.superseded for receiver in receivers),
            }
            self._delays, self._bytes, self._newest = {"footprint": [], "map": []}, 0, {}
        return report


def run_planners(endpoint: str, security: str, *names: str) -> None:
    """Planners; each line of the standard input asks for a report."""
    planners = Planners(list(names), endpoint, security)
    say(ready=True)
    for _ in sys.stdin:
        say(**planners.report())


if __name__ == "__main__":
    roles: dict[str, Any] = {"router": run_router, "zenohd": run_zenohd, "robots": run_robots, "planners": run_planners}
    roles[sys.argv[1]](*sys.argv[2:])
