"""Nodes, routers and planners that die, hang, are slow or come back: what the others get meanwhile."""

import signal
import time

import pytest

import transport
from tests.transport.client_at import client_at
from transport import keys


def test_nothing_in_time_is_a_timeout_and_a_death_is_reported(start, endpoint: str, eventually) -> None:
    """A wait that times out says whether the node lives; that it was killed is seen."""
    router = start("router", endpoint)
    node = start("node", endpoint, "connect")
    with client_at(endpoint) as client:
        assert client.wait_until_alive(30.0)
        with pytest.raises(transport.ReceiveTimeout, match="no matching message on"):
            client.wait_for_step(99, timeout=0.1)
        node.kill()
        assert eventually(lambda: not client.is_alive)
        with pytest.raises(transport.ScannerGone, match="disappeared"):
            client.wait_for_step(99, timeout=0.1)
    router.kill()


def test_a_hung_node_is_noticed(start, endpoint: str, eventually) -> None:
    """A stopped node loses its sign of life, though nothing closed its links."""
    start("router", endpoint)
    node = start("node", endpoint, "connect")
    with client_at(endpoint) as client:
        assert client.wait_until_alive(30.0)
        node.send(signal.SIGSTOP)
        assert eventually(lambda: not client.is_alive)


def test_the_newest_grid_arrives_after_the_router_was_killed(start, endpoint: str) -> None:
    """What was published while the router was dead arrives when it is back; twice."""
    router = start("router", endpoint)
    node = start("node", endpoint, "connect")
    with client_at(endpoint) as client:
        node.tell("publish 1")
        client.receive(lambda grid: grid.sequence == 1, timeout=180.0)
        for number in (2, 4):
            router.kill()
            node.tell(f"publish {number}")
            node.tell(f"publish {number + 1}")
            time.sleep(0.3)
            router = start("router", endpoint)
            assert client.receive(lambda grid, n=number: grid.sequence > n, timeout=180.0)


def test_a_stopped_planner_costs_the_healthy_one_nothing(start, endpoint: str) -> None:
    """While one planner hangs, the other gets every grid."""
    node = start("node", endpoint)
    stuck = start("planner", endpoint)
    with client_at(endpoint) as client:
        receiver = client.receiver()
        assert client.wait_until_alive(30.0)
        node.tell("publish 100")
        client.receive(lambda grid: grid.sequence == 100, timeout=180.0)
        before = receiver.received
        stuck.send(signal.SIGSTOP)
        # 60 grids of the usual 0.4 MB: more than the 16 MiB of shared memory, which the stopped one holds.
        node.tell("stream 60 0.15 27")
        node.expect("streamed 60")
        client.receive(lambda grid: grid.sequence == 60, timeout=180.0)
        assert receiver.received - before == 60 and receiver.missed == 0


def test_the_last_grid_of_a_burst_arrives_over_a_slow_link(start, endpoint: str, slow_link) -> None:
    """When a link is too slow for all grids some are lost, never the last, though nothing follows it."""
    node = start("node", endpoint)
    link = slow_link(endpoint, 2.5e6)
    # Without shared memory, or the payload would not go through the link at all.
    session = transport.open_client(link.endpoint, shared_memory=False, timeout=180.0)
    with transport.PerceptionClient(session) as client:
        node.tell("publish 100")
        client.receive(lambda grid: grid.sequence == 100, timeout=180.0)
        node.tell("stream 12 0.1 49")
        assert client.receive(lambda grid: grid.sequence == 12, timeout=60.0)
        assert client.receiver().received < 13


def test_a_node_killed_while_it_publishes_leaves_no_partial_grid(start, endpoint: str, peer) -> None:
    """Whatever arrived before a kill -9 in the middle of large puts is whole and of one scan."""
    router = start("router", endpoint)
    arrived: list[bool] = []
    with transport.open_client(endpoint, timeout=180.0) as session:
        receiver = transport.NewestReceiver(session, keys.terrain_key(), transport.decode_terrain)
        receiver.on_newest(lambda received: arrived.append(peer.is_whole(received.message)))
        for _ in range(3):
            node = start("node", endpoint, "connect")
            before = receiver.received
            node.tell("stream 12 0 250")
            deadline = time.monotonic() + 30.0
            while receiver.received < before + 2 and time.monotonic() < deadline:
                time.sleep(0.001)
            node.kill()
        assert receiver.rejected == 0
    router.kill()
    assert len(arrived) >= 3 and all(arrived)
