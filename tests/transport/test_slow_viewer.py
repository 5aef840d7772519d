"""A viewer on a slow link harms nobody else: no request of a local planner fails, and none of its grids waits."""

import numpy as np
import pytest

import transport
from transport.security.folder import init_security

SCANS = 25
# Megabits a second of the links over which viewers join, one after the other.
MEGABITS = (2.0, 5.0, 2.0)


@pytest.fixture(params=["tcp", "tls"])
def link(request, endpoint: str, tmp_path) -> tuple[str, dict[str, str]]:
    """Endpoint of a node, and the folder of each role: none for plain TCP."""
    if request.param == "tcp":
        return endpoint, dict.fromkeys(("node", "planner", "viewer"), "")
    keys = init_security(tmp_path / "keys")
    secured = endpoint.replace("tcp/127.0.0.1", "tls/localhost")
    return secured, {role: str(keys / role) for role in ("node", "planner", "viewer")}


def test_a_slow_viewer_costs_a_local_planner_nothing(start, slow_link, link) -> None:
    """Viewers join, ask for the last grids and leave while a planner asks for scans: these arrive within a second."""
    endpoint, folders = link
    node = start("node", endpoint, "listen", folders["node"])
    links = [slow_link(endpoint, megabits * 1e6 / 8) for megabits in MEGABITS]
    delays: list[float] = []
    with transport.open_client(endpoint, security=folders["planner"] or None, timeout=180.0) as session:
        client = transport.PerceptionClient(session)
        client.receiver("map")
        viewer = None
        for number in range(SCANS):
            if number % 10 == 4:
                # A late joiner: there are grids that it missed.
                viewer = start("viewer", links[number // 10].endpoint, folders["viewer"])
            if number % 10 == 9:
                viewer.kill()
            terrain = client.request_scan(timeout=20.0, request_id=f"large-{number}")
            arrival = client.receiver().latest().arrival_stamp
            delays.append((arrival - terrain.scan_end) * 1e-9)
        viewer.expect("got footprint")
    # Far above what a busy machine costs. Where a slow link holds grids up, every eighth is two to five seconds late.
    assert np.percentile(delays, 95) < 1.0, sorted(delays)[-5:]
    assert node.popen.poll() is None


def test_a_viewer_on_a_slow_link_gets_the_newest_in_pieces(start, slow_link, endpoint: str) -> None:
    """It gets the last grid whole; the grids that it did not get are counted."""
    node = start("node", endpoint)
    link = slow_link(endpoint, 5e6 / 8)
    session = transport.open_client(link.endpoint, timeout=30.0, shared_memory=False)
    with transport.PerceptionClient(session) as client:
        receiver = client.receiver()
        node.tell("stream 30 0.2 49")
        node.expect("streamed")
        assert client.receive(lambda grid: grid.sequence == 30, timeout=60.0)
        assert receiver.received < 30 and receiver.received + receiver.missed >= 30 - 1
        assert receiver.rejected == 0
