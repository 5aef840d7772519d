"""Tests of grids between processes: whole, newest only, late joiners, how old they may be, questions and status."""

import json
import math
import time
from contextlib import suppress

import numpy as np
import pytest

import transport
from tests.transport.client_at import client_at
from transport import keys
from transport.messages.codec import decode


def test_a_grid_travels_whole_between_processes(start, endpoint: str, peer) -> None:
    """A planner in another process gets the same grid, bit for bit."""
    node = start("node", endpoint)
    with client_at(endpoint) as client:
        client.receiver()
        node.tell("publish 5")
        terrain = client.receive(lambda grid: grid.sequence == 5, timeout=180.0).message
        expected = peer.make_terrain(5)
        for name, array in expected.layers.items():
            assert terrain.layers[name].tobytes() == array.tobytes(), name
        assert client.latest() is terrain
        for timeout in (math.nan, "1"):
            with pytest.raises(transport.MessageError, match=f"timeout is {timeout!r}; allowed: a number of seconds"):
                client.receive(lambda _: True, timeout=timeout)
        for max_age in (-1.0, math.nan, "1"):
            with pytest.raises(transport.MessageError, match=f"max_age is {max_age!r}; allowed: 0 s or more, or None"):
                client.latest(max_age=max_age)
    # A closed client would not hear what ends the grid's use.
    with pytest.raises(transport.SessionClosed):
        client.latest()


def test_late_joiners_get_the_last_grid(start, endpoint: str) -> None:
    """Whoever joins after the last scan still gets it, every time."""
    node = start("node", endpoint)
    node.tell("publish 1")
    node.tell("publish 2")
    node.tell("map 3")
    with client_at(endpoint) as client:
        client.receive(lambda grid: grid.sequence == 2, timeout=180.0)
        client.receive(lambda grid: grid.sequence == 3, timeout=30.0, extent="map")
    for _ in range(5):
        with client_at(endpoint) as client:
            assert client.receive(lambda _: True, timeout=180.0).message.sequence == 2
            assert client.receive(lambda _: True, timeout=30.0, extent="map").message.shape == (140, 320)
            assert client.latest().sequence == 2


def test_occupancy_and_grid_map_come_with_the_grid(start, endpoint: str, peer) -> None:
    """The two ROS 2 messages of a scan are latched too, and hold the same cells."""
    node = start("node", endpoint)
    node.tell("publish 4")
    terrain = peer.make_terrain(4)
    with transport.open_client(endpoint, timeout=180.0) as session:
        for key, name in ((keys.occupancy_key(), "nav_msgs/msg/OccupancyGrid"),
                          (keys.grid_map_key(), "grid_map_msgs/msg/GridMap")):  # fmt: skip
            receiver = transport.NewestReceiver(session, key, lambda raw, name=name: decode(raw, name))
            message = receiver.wait_for(lambda _: True, 30.0).message
            if "Occupancy" in name:
                assert (message.info.height, message.info.width) == (108, 90) and not message.data.any()
            else:
                assert message.layers[0] == "elevation" and len(message.layers) == 11 and "hazard" in message.layers
                slope = message.data[message.layers.index("slope")].data.reshape(108, 90)[::-1, ::-1]
                np.testing.assert_array_equal(slope, terrain.layers["slope"])
            assert message.header.frame_id == "base_footprint"


@pytest.mark.slow
def test_a_slow_reader_gets_the_newest_and_counts_the_rest(endpoint: str, peer, eventually) -> None:
    """Grids that nobody asked for are superseded, never queued."""
    with transport.open_node(listen=endpoint) as session:
        publisher = transport.Publisher(session, keys.terrain_key())
        with client_at(endpoint) as client:
            receiver = client.receiver()
            publisher.put(transport.encode_terrain(peer.make_terrain(100, shape=(4, 5))))
            client.receive(lambda grid: grid.sequence == 100, timeout=180.0)
            for sequence in range(1, 21):
                publisher.put(transport.encode_terrain(peer.make_terrain(sequence, shape=(4, 5))))
            assert eventually(lambda: receiver.received + receiver.missed == 21)
            assert client.latest().sequence == 20
            assert receiver.superseded == receiver.received - 2


@pytest.mark.slow
def test_callback_sees_only_newer_grids_and_survives_errors(endpoint: str, peer, eventually) -> None:
    """A callback that is slow and raises is called again with the newest, never with an older one."""
    seen: list[int] = []

    def callback(terrain: transport.TerrainMessage) -> None:
        seen.append(terrain.sequence)
        time.sleep(0.02)
        raise ValueError("the planner's mistake")

    with transport.open_node(listen=endpoint) as session:
        publisher = transport.Publisher(session, keys.terrain_key())
        with client_at(endpoint) as client:
            client.on_terrain(callback)
            for sequence in range(1, 31):
                publisher.put(transport.encode_terrain(peer.make_terrain(sequence, shape=(4, 5))))
            assert eventually(lambda: seen[-1:] == [30])
    assert seen == sorted(set(seen))


@pytest.mark.slow
def test_a_damaged_grid_is_an_error_not_an_older_grid(endpoint: str, peer, eventually) -> None:
    """After damage the reader gets an error, waiting passes it over, and the next grid is fine again."""
    with transport.open_node(listen=endpoint) as session:
        publisher = transport.Publisher(session, keys.terrain_key())
        with client_at(endpoint) as client:
            good = transport.encode_terrain(peer.make_terrain(1, shape=(4, 5)))
            publisher.put(good)
            client.receive(lambda grid: grid.sequence == 1, timeout=180.0)
            publisher.put(good[:-9])
            assert eventually(lambda: client.receiver().received == 2)
            with pytest.raises(transport.MessageError):
                client.latest()
            assert client.receiver().rejected == 1
            publisher.put(transport.encode_terrain(peer.make_terrain(2, shape=(4, 5))))
            assert client.receive(lambda grid: grid.sequence == 2, timeout=180.0).message.step == 2


@pytest.mark.slow
def test_age_decides_what_may_be_used(endpoint: str, peer) -> None:
    """A grid older than max_age, or than its own validity in time or pauses, is refused with a message."""
    with transport.open_node(listen=endpoint) as session:
        server = transport.PerceptionServer(session)
        with client_at(endpoint) as client:
            with pytest.raises(transport.StaleTerrain, match="is running but has not published a footprint grid yet"):
                client.latest()
            old = time.time_ns() - 5_000_000_000
            server.publish(peer.make_terrain(1, step=10, stamp=old, valid_for=60.0, valid_pauses=2))
            assert client.wait_for_step(10, timeout=180.0).sequence == 1
            assert client.latest().step == 10
            assert client.latest(max_age=30.0).step == 10
            with pytest.raises(transport.StaleTerrain, match=r"step 10\) is \d+\.\d+ s old; allowed: 1 s"):
                client.latest(max_age=1.0)
            server.publish(peer.make_terrain(2, step=11, stamp=old, valid_for=1.0))
            client.wait_for_step(11, timeout=30.0, max_age=math.inf)
            with pytest.raises(transport.ReceiveTimeout, match="allowed: 1 s"):
                client.wait_for_step(11, timeout=0.3)
            with pytest.raises(transport.StaleTerrain, match="allowed: 1 s"):
                client.latest()


@pytest.mark.slow
def test_a_grid_outlives_only_its_pauses(endpoint: str, peer, eventually) -> None:
    """When the robot has made more pauses than the grid is valid for, it is stale however young."""
    with transport.open_node(listen=endpoint) as session:
        server = transport.PerceptionServer(session)
        with client_at(endpoint) as client:
            server.publish(peer.make_terrain(1, step=3, valid_pauses=2))
            client.wait_for_step(3, timeout=180.0)
            for step in (3, 5):
                server.begin_step(step)
                assert eventually(
                    lambda step=step: (
                        (status := client.status()) is not None and status.items[0].values["step"] == str(step)
                    )
                )
                assert client.latest().step == 3
            server.begin_step(6)

            def is_stale() -> bool:
                try:
                    client.latest()
                except transport.StaleTerrain as error:
                    return "is 3 pauses old; allowed: 2" in str(error)
                return False

            assert eventually(is_stale)
            assert client.latest(allow_stale=True).step == 3


def test_a_node_of_another_version_is_named(endpoint: str) -> None:
    """Its keys differ, so that nothing is received: the error tells both versions."""
    with transport.open_node(listen=endpoint) as session, client_at(endpoint) as client:
        transport.AliveToken(session, "guara/perception/v9/@alive/node")
        with pytest.raises(
            transport.ScannerUnavailable, match="version v9 of the messages, but this package uses v1: install"
        ):
            client.latest()


@pytest.mark.slow
def test_without_a_node_the_scanner_is_unavailable(endpoint: str) -> None:
    """Nobody there is distinguished from nothing new."""
    with transport.open_node(listen=endpoint), client_at(endpoint) as client:
        with pytest.raises(transport.ScannerUnavailable, match="no node of robot 'guara' was found"):
            client.latest()
        with pytest.raises(transport.ScannerUnavailable):
            client.wait_for_step(1, timeout=0.1)
        with pytest.raises(transport.ScannerUnavailable):
            client.request_scan(timeout=0.5)
        with pytest.raises(transport.ScannerUnavailable, match="no node replies on 'guara/perception/v1/query'"):
            client.query(timeout=5.0)
        with pytest.raises(transport.MessageError, match="extent is 'all'"):
            client.latest(extent="all")


@pytest.mark.slow
def test_query_returns_the_newest_grid_or_a_region(endpoint: str, peer) -> None:
    """A question is answered with the newest grid, cut to the region when one is given."""
    with transport.open_node(listen=endpoint) as session:
        server = transport.PerceptionServer(session)
        with client_at(endpoint) as client:
            with pytest.raises(transport.StaleTerrain, match="no grid of extent 'map' yet"):
                client.query(extent="map")
            terrain = peer.make_terrain(8)
            server.publish(terrain)
            assert client.query().sequence == 8
            part = client.query(region=(0.6, 0.7, -0.1, 0.1))
            assert part.shape == (40, 20)
            np.testing.assert_allclose(part.origin, (0.6, -0.1))
            np.testing.assert_array_equal(part.layers["slope"], terrain.layers["slope"][34:74, 20:40])
            with pytest.raises(transport.MessageError, match="is empty or outside the grid"):
                client.query(region=(5.0, 6.0, 0.0, 1.0))
            with pytest.raises(transport.MessageError, match="is empty"):
                client.query(region=(1.0, 0.0, 0.0, 1.0))


@pytest.mark.slow
def test_server_refuses_grids_of_others(endpoint: str, peer) -> None:
    """A grid under another robot's name, an occupancy of another shape, an unknown extent: all are refused."""
    with transport.open_node(listen=endpoint) as session:
        server = transport.PerceptionServer(session, robot="rex")
        with pytest.raises(transport.MessageError, match="robot 'guara' given to the node of 'rex'"):
            server.publish(peer.make_terrain())
        with pytest.raises(transport.MessageError, match="occupancy has shape"):
            server.publish(peer.make_terrain(robot="rex"), occupancy=np.zeros((2, 2), np.int8))
        with pytest.raises(transport.MessageError, match="extent is 'all'"):
            server.next_sequence("all")
        assert [server.next_sequence("map") for _ in range(3)] == [1, 2, 3]


@pytest.mark.slow
def test_status_tells_how_the_node_does(endpoint: str, peer, eventually) -> None:
    """The status holds the transport's own figures and the items of the node, on change and again."""
    items = [transport.StatusItem(name="scanner", level=transport.Health.WARN, message="warm")]
    collect = [lambda: items]
    with transport.open_node(listen=endpoint) as session:
        server = transport.PerceptionServer(session, collect_status=lambda: collect[0]())
        with client_at(endpoint) as client:
            server.publish(peer.make_terrain(1, step=7))

            def is_reported() -> bool:
                status = client.status()
                return status is not None and status.items[0].values["last_scan_step"] == "7"

            assert eventually(is_reported)
            status = client.status()
            assert status.level is transport.Health.WARN and status.item("scanner").message == "warm"
            assert int(status.items[0].values["links"]) == 1
            first = status.stamp
            assert eventually(lambda: client.status().stamp > first)
            collect[0] = lambda: 1 / 0
            server.status_changed()
            assert eventually(lambda: client.status().level is transport.Health.ERROR)
            assert "division by zero" in client.status().item("status").message


@pytest.mark.slow
def test_status_counts_answers_with_a_grid_that_is_no_longer_of_use(endpoint: str, peer) -> None:
    """None yet, one of the pause, and the same after the next pause has begun."""
    with transport.open_node(listen=endpoint) as session:
        server = transport.PerceptionServer(session)

        def asked() -> tuple[int, int]:
            with suppress(transport.StaleTerrain):
                transport.query_terrain(client, timeout=30.0)
            values = server.status_items()[0].values
            return int(values["answers"]), int(values["answers_stale"])

        with transport.open_client(endpoint) as client:
            assert asked() == (1, 1)
            server.begin_step(7)
            server.publish(peer.make_terrain(1, step=7))
            assert asked() == (2, 1)
            server.begin_step(8)
            assert asked() == (3, 2)


@pytest.mark.slow
def test_a_coarse_grid_that_is_still_refined_can_be_skipped(endpoint: str, peer) -> None:
    """`wait_for_step` returns the newest at hand, unless the refined one is asked for."""
    with (
        transport.open_node(listen=endpoint) as session,
        client_at(endpoint) as client,
    ):
        server = transport.PerceptionServer(session)
        server.begin_step(1, "walk")
        for sequence, follows in ((1, True), (2, False)):
            metadata = json.dumps({"epoch": "walk", "provisional": True, "refinement_follows": follows})
            server.publish(peer.make_terrain(sequence, step=1, metadata=metadata))
            if follows:
                assert client.wait_for_step(1, timeout=180).refinement_follows
                with pytest.raises(transport.ReceiveTimeout):
                    client.wait_for_step(1, timeout=0.3, refined_only=True)
        assert not client.wait_for_step(1, timeout=180, refined_only=True).refinement_follows
