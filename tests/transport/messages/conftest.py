"""Payloads of every message."""

from collections.abc import Callable

import numpy as np
import pytest

import transport
from tests.transport.messages.samples import sample_pause, sample_status, sample_stream
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


@pytest.fixture
def payloads(peer) -> dict[str, tuple[bytes, Callable[[bytes], object]]]:
    """A small payload of every message, with what decodes it."""
    reply = transport.ScanReply(
        id="r", state=transport.ScanState.DONE, stripes_done=3, stripes_total=35, step=-1, sequence=9, stamp=5
    )
    query = transport.QueryRequest(extent="map", region=(0.0, 1.0, -1.0, 0.5))
    terrain = peer.make_terrain(shape=(2, 3))
    return {
        "guara_msgs/Terrain": (transport.encode_terrain(terrain), transport.decode_terrain),
        "guara_msgs/StancePause": (
            transport.encode_stance_pause(sample_pause(peer)),
            transport.decode_stance_pause,
        ),
        "guara_msgs/StanceStream": (
            transport.encode_stance_stream(sample_stream(peer)),
            transport.decode_stance_stream,
        ),
        "guara_msgs/ScanRequest": (
            encode_scan_request(transport.ScanRequest(id="a", mode="coarse", timeout=3.0)),
            decode_scan_request,
        ),
        "guara_msgs/ScanReply": (encode_scan_reply(reply), decode_scan_reply),
        "guara_msgs/Refusal": (
            encode_refusal(transport.Refusal(id="a", code="busy", message="later")),
            decode_refusal,
        ),
        "guara_msgs/QueryRequest": (encode_query_request(query), decode_query_request),
        "diagnostic_msgs/DiagnosticArray": (transport.encode_status(sample_status(peer)), transport.decode_status),
        "nav_msgs/OccupancyGrid": (
            transport.encode(transport.occupancy_message(np.zeros((2, 3), np.int8), 0.1, (0, 0), "base_footprint", 1)),
            lambda payload: transport.decode(payload, "nav_msgs/msg/OccupancyGrid"),
        ),
        "grid_map_msgs/GridMap": (
            transport.encode(
                transport.grid_map_message(
                    {"elevation": np.zeros((2, 3), np.float32)}, 0.1, (0, 0), "base_footprint", 1
                )
            ),
            lambda payload: transport.decode(payload, "grid_map_msgs/msg/GridMap"),
        ),
    }
