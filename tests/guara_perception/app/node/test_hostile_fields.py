"""Extreme values in every field of messages to a running node with a recorder and to a client: both keep working."""

import dataclasses
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.app.messages import stance_to_message, terrain_to_message
from guara_perception.app.node.recorder import ScanRecorder
from guara_perception.terrain.layers.geometry import GridGeometry
from guara_perception.terrain.layers.record import ScanRecord
from tests.guara_perception.app.node.live_bench import TIMEOUT, Bench, wait_until
from tests.transport.messages.extremes import extremes
from transport import (
    GroundPatch,
    Health,
    MessageError,
    PausePhase,
    Publisher,
    QueryRequest,
    ScanRequest,
    StancePause,
    Status,
    StatusItem,
    TransportError,
    encode,
    encode_status,
    open_client,
    open_node,
)
from transport.keys import query_key, regions_key, scan_key, stance_key, status_key, summary_key, terrain_key
from transport.links.publisher import URGENT
from transport.messages.codec import decode
from transport.messages.map_messages import RegionsMessage, SummaryMessage, encode_regions, encode_summary, origin_of
from transport.messages.scan_messages import encode_query_request, encode_scan_request
from transport.messages.stance_pause import make_stance_pause
from transport.messages.status_message import STATUS_NAME
from transport.messages.terrain_message import make_terrain
from transport.messages.typestore import QUERY_REQUEST, REGIONS, SCAN_REQUEST, STATUS, SUMMARY
from transport.recording import open_recording
from transport.server import PerceptionServer
from transport.supervision import Failure, follow, forget

pytestmark = pytest.mark.slow
BenchWith = Callable[..., AbstractContextManager[Bench]]


@pytest.fixture
def told() -> Iterator[list[Failure]]:
    """Failures of threads and callbacks during a test."""
    failures: list[Failure] = []
    follow(failures.append)
    yield failures
    forget(failures.append)


def payloads_of(message: Any) -> Iterator[bytes]:
    """Extreme values of a message that fit the types of its fields."""
    for _, changed in extremes(message):
        try:
            yield bytes(encode(changed))
        except MessageError:
            continue


def test_no_announcement_and_no_request_stops_a_node(
    bench_with: BenchWith, tmp_path: Path, calibration: gp.Calibration, free_endpoint: str, told: list[Failure]
) -> None:
    """Each is sent in its own pause; then a pause is scanned as before, no thread failed, and the recording is
    complete.
    """
    path = tmp_path / "walk.mcap"
    with (
        ScanRecorder(path, robot="guara", calibration=calibration) as recorder,
        bench_with(recorder) as bench,
        open_client(free_endpoint) as session,
    ):
        # With the gait's own priority, so that none arrives after the last announcement of the gait.
        announcements = Publisher(bench.gait.session, stance_key(), latched=False, priority=URGENT)
        ground = GroundPatch(outline=np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]]), height=0.0, sigma=0.01)
        count = 0
        for phase in (PausePhase.BEGIN, PausePhase.HOLD, PausePhase.END):
            pause = StancePause(
                robot="guara",
                step=1,
                phase=phase,
                stamp=time.time_ns(),
                stance=stance_to_message(bench.gait.stance),
                time_available=0.0,
                known_ground=(ground,),
                epoch="a walk",
            )
            for payload in payloads_of(make_stance_pause(pause)):
                announcements.put(payload)
                count += 1
        for key, payload in (
            (scan_key(), encode_scan_request(ScanRequest(id="a", mode="coarse", timeout=1.0))),
            (query_key(), encode_query_request(QueryRequest(extent="map", region=(0.0, 1.0, 0.0, 1.0)))),
        ):
            message = decode(payload, SCAN_REQUEST if key == scan_key() else QUERY_REQUEST)
            for changed in payloads_of(message):
                session.raw.get(key, payload=changed, timeout=0.2)
                count += 1
        # Another walk, because the steps of the previous one reach the largest integer.
        assert wait_until(lambda: bench.client.status() is not None)
        bench.gait.say(0, PausePhase.BEGIN, epoch="the next walk", stamp=time.time_ns() + 10**9)
        assert bench.client.wait_for_step(0, timeout=TIMEOUT).step == 0
        assert told == []
        status = bench.client.status()
        assert status is not None
        item = status.item("thread guara-scans")
        assert item is not None and item.message == "running"
        print(f"{count} messages to the node")
        assert count > 500
    with open_recording(path) as recording:
        assert recording is not None


def test_no_grid_status_or_summary_stops_a_client(
    paper_terrain: gp.TerrainGrid, free_endpoint: str, told: list[Failure]
) -> None:
    """Sent on the keys of a running node: the client raises documented errors only, and no part of it fails."""
    small = gp.TerrainGrid(
        layers={name: array[:2, :3] for name, array in paper_terrain.layers.items()},
        geometry=GridGeometry(paper_terrain.origin, paper_terrain.resolution, (2, 3)),
        frame=paper_terrain.frame,
        stamp=paper_terrain.stamp,
        step=paper_terrain.step,
        extent=paper_terrain.extent,
        record=ScanRecord.from_json(dict(paper_terrain.metadata)),
    )
    terrain = terrain_to_message(small, robot="guara", sequence=1)
    wide = dataclasses.replace(terrain, extent="map")
    summary = SummaryMessage(
        **origin_of(wide),
        resolution=0.1,
        origin=(0.0, 0.0),
        heights=np.full((2, 3), -32768, np.int16),
        hazard=np.full((2, 3), 4, np.uint16),
        traversability=np.zeros((2, 3), np.uint8),
    )
    items = (StatusItem(name="transport", level=Health.OK, values={"run": "a", "clock_s": "1.5", "step": "3"}),)
    heard: list[gp.TerrainGrid] = []
    outcomes: Counter[str] = Counter()
    with (
        open_node(listen=free_endpoint) as node,
        open_client(free_endpoint) as session,
        gp.TerrainClient(free_endpoint) as client,
    ):
        server = PerceptionServer(node)
        client.on_terrain(heard.append)
        asks = {
            terrain_key(): (make_terrain(terrain), lambda: client.latest(allow_stale=True)),
            summary_key(): (decode(encode_summary(summary), SUMMARY), lambda: client.summary(0.001, allow_stale=True)),
            regions_key(): (
                decode(encode_regions(RegionsMessage(**origin_of(wide), regions=())), REGIONS),
                lambda: client.regions(0.001, allow_stale=True),
            ),
            status_key(): (decode(encode_status(Status(stamp=1, items=items)), STATUS), client.status),
        }
        for key, (message, ask) in asks.items():
            publisher = Publisher(session, key, latched=False)
            for payload in payloads_of(message):
                publisher.put(payload)
                try:
                    ask()
                    outcomes["asked"] += 1
                except (TransportError, gp.PerceptionError):
                    outcomes["refused"] += 1

        def hears_the_node() -> bool:
            try:
                status = client.status()
            except MessageError:
                return False
            item = None if status is None else status.item(STATUS_NAME)
            return item is not None and item.values["run"] == server.run

        assert wait_until(hears_the_node)
        server.close()
    print(f"messages to the client: {dict(outcomes)}")
    assert told == []
    assert sum(outcomes.values()) > 700 and min(outcomes.values()) > 20
