"""Messages cut at every length and with bytes changed: refused, or read as another valid message; never a crash."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

import transport
from benchmarks.transport_peer import make_terrain
from transport.messages.scan_messages import (
    decode_query_request,
    decode_refusal,
    decode_scan_reply,
    decode_scan_request,
    encode_query_request,
    encode_refusal,
    encode_scan_reply,
    encode_scan_request,
)

# Truncations that are whole messages of an earlier version: gaits built before walks had an identity send no `epoch`.
EARLIER = {"StancePause": 1}


def damaged(flips: int) -> Iterator[tuple[str, str, str, bool]]:
    """Decode every truncation of each message, and messages with one byte changed.

    Args:
        flips: number of changed messages of each kind.

    Yields:
        For each kind of message: what was done, what was measured, what is allowed, and whether it is met.
    """
    for name, (message, decode) in _messages().items():
        payload = bytes(message)
        rng = np.random.default_rng(1)
        outcome = {"refused": 0, "valid": 0, "crash": 0}
        read_cut = 0
        decode(payload)
        tracemalloc.start()
        for length in range(len(payload)):
            try:
                decode(payload[:length])
                read_cut += 1
            except transport.TransportError:
                continue
        for _ in range(flips):
            changed = bytearray(payload)
            changed[rng.integers(4, len(payload))] = rng.integers(0, 256)
            try:
                decode(bytes(changed))
                outcome["valid"] += 1
            except transport.TransportError:
                outcome["refused"] += 1
            except Exception:
                outcome["crash"] += 1
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        counts = ", ".join(f"{count} {result}" for result, count in outcome.items())
        measured = f"{counts}, peak {peak / 1e3:.0f} kB"
        met = read_cut == EARLIER.get(name, 0) and outcome["crash"] == 0 and peak < 5e6
        yield (
            f"{name}: {len(payload)} truncations, {flips} byte flips",
            measured,
            f"{EARLIER.get(name, 0)} truncations read, no crash",
            met,
        )


def _messages() -> dict[str, tuple[bytes | bytearray, Callable[[bytes], Any]]]:
    stance = transport.StanceMessage(joint_positions={"a": 1.0, "b": 2.0}, support_feet=("lf", "rf"))
    ground = transport.GroundPatch(outline=np.array([[0, 0], [1, 0], [1, 1]]), height=0.0, sigma=0.01)
    pause = transport.StancePause(
        robot="guara", step=1, phase=transport.PausePhase.BEGIN, stamp=1, stance=stance, known_ground=(ground,)
    )
    item = transport.StatusItem(name="a", level=transport.Health.OK, values={"x": "1"})
    scan_reply = transport.ScanReply(id="a", state=transport.ScanState.DONE)
    values = np.zeros((4, 5))
    occupancy = transport.occupancy_message(values.astype(np.int8), 0.1, (0, 0), "base_footprint", 1)
    grid_map = transport.grid_map_message({"elevation": values}, 0.1, (0, 0), "base_footprint", 1)
    return {
        "Terrain": (transport.encode_terrain(make_terrain(1, (4, 5))), transport.decode_terrain),
        "StancePause": (transport.encode_stance_pause(pause), transport.decode_stance_pause),
        "ScanRequest": (
            encode_scan_request(transport.ScanRequest(id="a", mode="coarse", timeout=1.0)),
            decode_scan_request,
        ),
        "ScanReply": (encode_scan_reply(scan_reply), decode_scan_reply),
        "Refusal": (encode_refusal(transport.Refusal(id="a", code="busy", message="later")), decode_refusal),
        "QueryRequest": (encode_query_request(transport.QueryRequest(region=(0, 1, 0, 1))), decode_query_request),
        "DiagnosticArray": (
            transport.encode_status(transport.Status(stamp=1, items=(item,))),
            transport.decode_status,
        ),
        "OccupancyGrid": (
            transport.encode(occupancy),
            lambda payload: transport.decode(payload, "nav_msgs/msg/OccupancyGrid"),
        ),
        "GridMap": (
            transport.encode(grid_map),
            lambda payload: transport.decode(payload, "grid_map_msgs/msg/GridMap"),
        ),
    }
