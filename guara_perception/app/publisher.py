"""Publication of grids, and of the messages derived from them, without delaying a scan."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from typing import Any
from weakref import WeakKeyDictionary

from guara_perception.app.map_summary import regions_message, summary_payload
from guara_perception.app.messages import terrain_to_message
from guara_perception.exceptions import InvalidInput, refuse_stale
from guara_perception.terrain.grid import TerrainGrid
from transport import TerrainMessage, clock
from transport.keys import DEFAULT_ROBOT
from transport.links.session import Session
from transport.server import PerceptionServer

# Servers of `publish_terrain` by session and name.
_SERVERS: WeakKeyDictionary[Session, dict[str, PerceptionServer]] = WeakKeyDictionary()


def send_terrain(
    server: PerceptionServer,
    terrain: TerrainGrid,
    *,
    scan_start: int | None = None,
    scan_end: int | None = None,
    scan_end_clock: float | None = None,
    valid_for: float = math.inf,
    stated: Mapping[str, Any] | None = None,
) -> TerrainMessage:
    """Queue a grid for sending; return its message without waiting.

    Args:
        server: the node's side of the transport.
        terrain: grid of either extent. A footprint is also sent as OccupancyGrid and GridMap, a map as summary and
            steppable regions.
        scan_start, scan_end: times of the first and last frame [ns since the Unix epoch]; None = the grid's stamp.
        scan_end_clock: time of the last frame on `transport.clock` [s]; None = computed from `scan_end` and the wall
            clock.
        valid_for: upper limit of the grid's validity after `scan_end` [s].
        stated: fields of the record to replace in the message.

    Raises:
        UnsafeGrid: the grid violates the safety invariant; nothing is sent.
        InvalidInput: a field of the grid's record has a value that a receiver cannot read back.
    """
    if scan_end_clock is None:
        end = terrain.stamp if scan_end is None else scan_end
        scan_end_clock = clock.now() - max(0.0, (time.time_ns() - end) * 1e-9)
    message = terrain_to_message(
        terrain,
        robot=server.robot,
        sequence=server.next_sequence(terrain.extent),
        scan_start=scan_start,
        scan_end=scan_end,
        valid_for=valid_for,
        stated={**(stated or {}), "run": server.run, "scan_end_clock": scan_end_clock},
    )
    if terrain.extent == "footprint":
        server.publish(message, occupancy=terrain.to_occupancy())
    else:
        server.publish(
            message,
            summary=lambda: summary_payload(message),
            regions=lambda: regions_message(terrain, message),
        )
    return message


def publish_terrain(session: Session, terrain: TerrainGrid, name: str = "") -> None:
    """Publish a grid of your own, for instance from another sensor, for clients with `robot=name`.

    The first call for a session and name waits up to 15 s for another node of that name to stop; later calls return
    immediately. The age of the grid counts from its stamp. The publisher, with its status and liveliness token, ends
    with the session.

    Args:
        session: open session from `transport.open_node` or `transport.open_client`.
        terrain: grid of either extent.
        name: instance name under which clients find the grid; "" = the name of the grid's robot (DEFAULT_ROBOT if it
            names none) with the suffix `_own`, since the name alone belongs to the robot's perception node.

    Raises:
        InvalidInput: `session` or `terrain` is of another type, or a field of the grid's record has a value that a
            receiver cannot read back.
        UnsafeGrid: the grid violates the safety invariant; nothing is sent.
        transport.NameTaken: after 15 s, another node still uses the name, or waits for it and takes precedence.
        transport.KeyNameError: the name cannot be part of a key.
        transport.SessionClosed: the session is closed.
        transport.StaleTerrain: the grid is stale; a receiver would take it for a new one.
    """
    if not isinstance(terrain, TerrainGrid):
        given = type(terrain).__name__
        raise InvalidInput(
            f"terrain is a {given}; allowed: a TerrainGrid (`assess_terrain` makes one from an array of heights)"
        )
    if not isinstance(session, Session):
        given = f"{type(session).__module__}.{type(session).__name__}"
        raise InvalidInput(f"session is a {given}; allowed: one of transport.open_client or transport.open_node")
    refuse_stale(terrain.stale_because, allow_stale=False)
    name = name or f"{terrain.record.robot or DEFAULT_ROBOT}_own"
    servers = _SERVERS.setdefault(session, {})
    if name not in servers:
        servers[name] = PerceptionServer(session, robot=name)
    send_terrain(servers[name], terrain)
