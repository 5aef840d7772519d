"""Publisher of the grids of one robot as Terrain, OccupancyGrid and GridMap, which never makes a scan wait."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from typing import Any

from guara_perception.app.map_summary import regions_message, summary_payload
from guara_perception.app.messages import terrain_to_message
from guara_perception.terrain.grid import TerrainGrid
from transport import TerrainMessage, clock
from transport.server import PerceptionServer


def publish_terrain(
    server: PerceptionServer,
    terrain: TerrainGrid,
    *,
    scan_start: int | None = None,
    scan_end: int | None = None,
    scan_end_clock: float | None = None,
    valid_for: float = math.inf,
    stated: Mapping[str, Any] | None = None,
) -> TerrainMessage:
    """Queue one grid for sending; return its message at once.

    Args:
        server: the node's side of the transport.
        terrain: grid of either extent; of a footprint the occupancy and the grid map go out too, of a map its
            summary and its steppable regions.
        scan_start, scan_end: first and last frame [ns since the epoch]; None = the grid's stamp.
        scan_end_clock: last frame by `transport.clock` [s]; None = computed from `scan_end` and the wall clock.
        valid_for: at most this long after `scan_end`, besides the grid's own validity [s].
        stated: fields of the record that differ in the message.

    Raises:
        UnsafeGrid: the grid breaks the safety invariant; nothing is sent.
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
