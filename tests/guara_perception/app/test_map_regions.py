"""Steppable regions from a node to a planner without a map: the same half-planes, with safe footholds inside them."""

import dataclasses
import time
from pathlib import Path

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.app.map_summary import message_to_regions, regions_message
from guara_perception.app.messages import terrain_to_message
from transport import TerrainMessage, open_node
from transport.messages.map_messages import RegionsMessage, decode_regions, encode_regions
from transport.server import PerceptionServer

PATIENCE = 60.0


def test_regions_arrive_as_the_map_has_them(paper_terrain: gp.TerrainGrid) -> None:
    """Through the encoded message and back; a withdrawn grid has none."""
    message = terrain_to_message(paper_terrain, robot="rex", sequence=3)
    got = message_to_regions(decode_regions(encode_regions(regions_message(paper_terrain, message))))
    regions = paper_terrain.steppable_regions()
    assert len(got.regions) == len(regions) > 0
    assert (got.robot, got.step, got.sequence) == ("rex", paper_terrain.step, 3)
    rng = np.random.default_rng(0)
    for computed, received in zip(regions, got.regions, strict=True):
        np.testing.assert_array_equal(computed.halfspaces, received.halfspaces)
        np.testing.assert_allclose(computed.plane, received.plane, rtol=0, atol=1e-9)
        inside = rng.dirichlet(np.ones(len(received.vertices)), 50) @ received.vertices
        assert paper_terrain.check_foothold(inside[:, 0], inside[:, 1]).ok.all()
        assert all(received.contains(x, y) for x, y, _ in inside)


def test_they_are_found_only_for_those_who_ask(free_endpoint: str, paper_terrain: gp.TerrainGrid, eventually) -> None:
    """Not without a subscriber; once for a planner that subscribes later, and then once per map."""
    found: list[int] = []

    def regions(message: TerrainMessage) -> RegionsMessage:
        found.append(message.step)
        return regions_message(paper_terrain, message)

    with open_node(listen=free_endpoint) as session:
        server = PerceptionServer(session, robot="rex")

        def publish(step: int) -> None:
            sequence = server.next_sequence("map")
            fused = dataclasses.replace(paper_terrain, stamp=time.time_ns(), step=step, extent="map", pictures={})
            message = terrain_to_message(fused, robot="rex", sequence=sequence)
            server.publish(message, regions=lambda: regions(message))
            server.flush()

        publish(1)
        publish(2)
        assert found == []
        with gp.TerrainClient(free_endpoint, robot="rex", timeout=PATIENCE) as client:
            assert client.regions(timeout=PATIENCE).step == 2
            assert found == [2]
            publish(3)
            assert eventually(lambda: client.regions().step == 3)
            assert found == [2, 3]


@pytest.mark.slow
def test_they_come_with_each_map_and_late_joiners_get_the_last(
    start, free_endpoint: str, terrain_file: Path, eventually
) -> None:
    """The map is not received; the newest regions are returned, and old or missing ones are reported."""
    node = start(Path(__file__).with_name("publishing_node.py"), free_endpoint, "rex", terrain_file)
    assert node.line() == "ready"
    node.tell("map 1")
    expected = len(gp.load_terrain(terrain_file).steppable_regions())
    with gp.TerrainClient(free_endpoint, robot="rex", timeout=PATIENCE) as client:
        got = client.regions(timeout=PATIENCE)
        assert (got.step, got.robot, len(got.regions)) == (1, "rex", expected)
        node.tell("map 2")
        assert eventually(lambda: client.regions().step == 2)
        with pytest.raises(gp.StaleTerrain, match="newest regions grid"):
            client.regions(timeout=0.5, max_age=0.0)
    with gp.TerrainClient(free_endpoint, robot="nobody", timeout=PATIENCE) as client:
        with pytest.raises(gp.ScannerUnavailable):
            client.regions(timeout=0.5)
