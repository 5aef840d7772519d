"""Whose a grid is, and how old: judged alike for every way of receiving; a name has only one node."""

import json
import math
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest

import transport
from tests.thorough import further
from transport import clock, keys
from transport.links.publisher import Publisher
from transport.node_name import open_only_node

PATIENCE = 30.0
CLOCK_BEHIND = """
import sys, time
behind = time.time_ns
time.time_ns = lambda: behind() - int(float(sys.argv[2]) * 1e9)
import transport
with transport.PerceptionClient(transport.open_client(sys.argv[1], timeout=180.0)) as client:
    client.receive(lambda grid: True, timeout=180.0, max_age=float("inf"))
    try:
        print("got", client.latest(max_age=40.0).step)
    except transport.StaleTerrain as error:
        print("stale", error)
    print("offset", client.clock_offset.offset, client.clock_offset.doubt)
"""


def make_grid(peer, server: transport.PerceptionServer, sequence: int, *, age: float = 0.0, **fields: object):
    """A grid as a node of today sends it: with its run, and the end of its scan by a clock that never jumps."""
    reported = {"run": server.run, "epoch": "walk-a", "scan_end_clock": clock.now() - age, "provisional": False}
    metadata = json.dumps({**reported, **fields.pop("metadata", {})})
    end = time.time_ns() - round(age * 1e9)
    return peer.make_terrain(sequence, metadata=metadata, stamp=end, **fields)


@pytest.fixture
def node(endpoint: str):
    """A node of this process."""
    with transport.open_node(listen=endpoint) as session:
        yield transport.PerceptionServer(session)


@pytest.fixture
def client(node, endpoint: str):
    """A planner with a session of its own."""
    with transport.PerceptionClient(transport.open_client(endpoint, timeout=PATIENCE)) as made:
        yield made


FOREIGN: dict[str, tuple[dict[str, object], str]] = {
    "another robot": ({"robot": "other"}, "its robot is 'other', not 'guara'"),
    "another extent": ({"extent": "map"}, "its extent is 'map', not 'footprint'"),
    "another frame": ({"frame_id": "odom"}, "its frame is 'odom', not 'base_footprint'"),
    "another run": ({"metadata": {"run": "other"}}, "from run 'other'"),
    "an older sequence": ({}, "its sequence number 2 is not above 3"),
}


@pytest.mark.parametrize("what", FOREIGN)
def test_a_grid_of_somebody_else_is_not_taken(what: str, node, client, endpoint: str, peer, eventually, caplog) -> None:
    """Without security anybody may put on the key: the newest grid of our node stays, and the log says what came."""
    fields, expected_text = FOREIGN[what]
    node.publish(make_grid(peer, node, 3, step=3))
    assert client.wait_for_step(3, timeout=PATIENCE).sequence == 3
    heard: list[int] = []
    client.on_terrain(lambda terrain: heard.append(terrain.sequence))
    with transport.open_client(endpoint, timeout=PATIENCE) as intruder:
        raw = Publisher(intruder, keys.terrain_key())
        raw.put(transport.encode_terrain(make_grid(peer, node, 2 if "older" in what else 9, step=9, **fields)))
        assert eventually(lambda: client.receiver().refused == 1)
    assert client.latest().sequence == 3 and expected_text in caplog.text
    node.publish(make_grid(peer, node, 10, step=10))
    assert client.wait_for_step(10, timeout=PATIENCE).sequence == 10
    assert set(heard) <= {3, 10}


def test_a_flood_of_foreign_grids_does_not_flood_the_log(node, client, endpoint: str, peer, eventually, caplog) -> None:
    """One line, then a count."""
    node.publish(make_grid(peer, node, 1, step=1))
    client.wait_for_step(1, timeout=PATIENCE)
    with transport.open_client(endpoint, timeout=PATIENCE) as intruder:
        raw = Publisher(intruder, keys.terrain_key())
        payload = transport.encode_terrain(make_grid(peer, node, 2, robot="other", shape=(2, 3)))
        for _ in range(200):
            raw.put(payload)
        assert eventually(lambda: client.receiver().refused >= 100)
    assert caplog.text.count("refused: ") == 1


@pytest.mark.slow
def test_a_flood_of_malformed_announcements_does_not_flood_the_log(endpoint: str, eventually, caplog) -> None:
    """2,000 invalid ones: the node hears of it, the log gets one line, and the next good one is heard."""
    refused: list[str] = []
    heard: list[int] = []
    with transport.open_node(listen=endpoint) as session, transport.open_client(endpoint, timeout=PATIENCE) as other:
        transport.StanceReceiver(
            session,
            on_pause=lambda pause: heard.append(pause.step),
            on_refused=lambda error: refused.append(str(error)),
        )
        raw = Publisher(other, keys.stance_key("guara"))
        for _ in range(2000):
            raw.put(b"no message at all")
        stance = transport.StanceMessage(joint_positions={"a": 0.1}, support_feet=("lf",))
        good = transport.StancePause(robot="guara", step=7, phase=transport.PausePhase.END, stamp=1, stance=stance)
        assert eventually(lambda: raw.put(bytes(transport.encode_stance_pause(good))) or 7 in heard)
    assert refused and caplog.text.count("refused") == 1


def ways(client: transport.PerceptionClient) -> dict[str, Callable[[], object]]:
    return {
        "latest": client.latest,
        "wait_for_step": lambda: client.wait_for_step(1, timeout=0.5),
        "receive": lambda: client.receive(lambda grid: True, timeout=0.5),
        "query": client.query,
    }


def test_an_old_grid_is_old_for_every_way_of_receiving(node, endpoint: str, peer) -> None:
    """A planner that joins gets the last grid, an hour old, and learns its age whichever way it asks."""
    node.publish(make_grid(peer, node, 1, age=3600.0, valid_for=420.0))
    node.flush()
    with transport.PerceptionClient(transport.open_client(endpoint, timeout=PATIENCE)) as client:
        assert client.wait_for_step(1, timeout=PATIENCE, max_age=math.inf).sequence == 1
        heard: list[int] = []
        client.on_terrain(lambda terrain: heard.append(terrain.sequence))
        for way, ask in ways(client).items():
            with pytest.raises((transport.StaleTerrain, transport.ReceiveTimeout), match=r"36\d\d\.\d+ s old"):
                ask()
                pytest.fail(way)
        assert client.query(max_age=math.inf).sequence == 1
        node.publish(make_grid(peer, node, 2))
        assert client.wait_for_step(2, timeout=PATIENCE).sequence == 2
        assert all(asked().sequence == 2 for asked in (client.latest, client.query))
    assert 1 not in heard


def test_a_walk_that_counts_anew_is_another_walk(node, client, peer, eventually) -> None:
    """After step 600 of a walk, step 0 of the next: no grid of the walk before is given for it."""
    for extent, sequence in (("footprint", 1), ("map", 1)):
        node.publish(make_grid(peer, node, sequence, step=600, extent=extent, valid_pauses=40))
    assert client.wait_for_step(600, timeout=PATIENCE, extent="map").step == 600
    assert client.wait_for_step(600, timeout=PATIENCE).epoch == "walk-a"
    node.begin_step(0, "walk-b")
    for extent in ("footprint", "map"):
        with pytest.raises(transport.ReceiveTimeout, match="from walk 'walk-a'; the robot is on walk 'walk-b'"):
            client.wait_for_step(0, timeout=0.5, extent=extent)
        with pytest.raises(transport.StaleTerrain, match="the robot is on walk 'walk-b'"):
            client.latest(extent=extent)
    for step in (0, 44):
        node.publish(make_grid(peer, node, 2 + step, step=step, metadata={"epoch": "walk-b"}))
        assert client.wait_for_step(step, timeout=PATIENCE).epoch == "walk-b"
        assert client.latest().step == step
    with pytest.raises(transport.ReceiveTimeout):
        client.wait_for_step(0, timeout=0.3, epoch="walk-a")


@pytest.mark.parametrize("behind", [-3600.0, *further(45.0)])
def test_ages_do_not_depend_on_the_wall_clocks(node, endpoint: str, peer, behind: float) -> None:
    """A planner whose clock is 45 s behind, or an hour ahead: a grid of 47 s is 47 s old, one of now is fresh."""
    for sequence, age, found in ((1, 47.0, "stale"), (2, 0.0, "got 2")):
        node.publish(make_grid(peer, node, sequence, age=age, valid_for=420.0))
        node.flush()
        planner = subprocess.run(
            [sys.executable, "-c", CLOCK_BEHIND, endpoint, str(behind)],
            capture_output=True,
            text=True,
            timeout=400,
            check=True,
        )
        said, offset = planner.stdout.splitlines()[:2]
        assert said.startswith(found), planner
        if found == "stale":
            assert 47.0 <= float(said.split(" is ")[1].split()[0]) < 90.0
        estimate, doubt = map(float, offset.split()[1:])
        assert abs(estimate - behind) <= doubt + 0.01


def test_a_jump_of_the_nodes_clock_is_reported(node, client, eventually, monkeypatch: pytest.MonkeyPatch) -> None:
    """Set back by an hour: the status says by how much; and the planner's own jump stands in its offset."""
    assert eventually(lambda: client.clock_offset is not None)
    real = time.time_ns
    monkeypatch.setattr(time, "time_ns", lambda: real() - 3600 * 10**9)
    node.status_changed()

    def is_reported() -> bool:
        item = client.status().item("clock")
        return item is not None and "jumped by -3600.0 s" in item.message

    assert eventually(is_reported)
    assert client._judge.clock.ask()
    assert client.clock_offset.jumps == 1


def test_a_second_node_of_a_name_is_refused_and_both_say_why(start, endpoint: str, eventually) -> None:
    """On one router: it waits, then goes; the first one's status says who waits. After a kill -9 the name is free."""
    start("router", endpoint)
    first = start("node", endpoint, "connect")
    with transport.PerceptionClient(transport.open_client(endpoint, timeout=PATIENCE)) as client:
        assert client.wait_until_alive(PATIENCE)
        with transport.open_node(connect=endpoint, timeout=PATIENCE) as session:
            refused: list[Exception] = []

            def begin() -> None:
                try:
                    transport.PerceptionServer(session, name_timeout=6.0)
                except transport.NameTaken as error:
                    refused.append(error)

            second = threading.Thread(target=begin)
            second.start()
            assert eventually(lambda: client.status() is not None and client.status().item("name") is not None)
            assert "another node is waiting for the name 'guara'" in client.status().item("name").message
            second.join(PATIENCE)
            assert "another node on this router still uses or waits for the name 'guara'" in str(refused[0])
        assert eventually(lambda: client.status().item("name") is None)
        first.kill()
        start("node", endpoint, "connect")
        assert eventually(lambda: client.is_alive)
        assert client.request_scan(timeout=PATIENCE).sequence >= 1


@pytest.mark.parametrize("is_secured", [False, True], ids=["plain", "tls"])
def test_a_second_node_waits_for_the_port_of_the_first(
    start, endpoint: str, eventually, tmp_path: Path, is_secured: bool
) -> None:
    """Where the node is its own router: refused after a while, which both sides report; after a kill -9 it has it."""
    folder = None
    if is_secured:
        folder = transport.init_security(tmp_path / "keys")
        # On all networks, as a secured node listens unless configured otherwise.
        endpoint = endpoint.replace("tcp/127.0.0.1", "tls/0.0.0.0")
    first = start("node", endpoint, "listen", str(folder or ""))
    with pytest.raises(transport.ConnectionFailed, match=r"waited 1 s for the port"):
        open_only_node(listen=endpoint, security=folder, timeout=1.0)
    opened: list[transport.Session] = []
    waiting = threading.Thread(target=lambda: opened.append(open_only_node(listen=endpoint, security=folder)))
    near, planner = endpoint.replace("0.0.0.0", "localhost"), folder and folder / "planner"
    with transport.PerceptionClient(transport.open_client(near, security=planner, timeout=PATIENCE)) as client:
        waiting.start()
        assert eventually(lambda: client.status() is not None and client.status().item("name") is not None)
        first.kill()
        waiting.join(PATIENCE)
        with opened[0] as session:
            server = transport.PerceptionServer(session)
            assert eventually(lambda: client.is_alive and server.run in client._judge._live.names)
