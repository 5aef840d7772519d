"""Planner that outlives its node: real processes and real Zenoh, every way of receiving grids, kill -9."""

import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

import guara_perception as gp
from transport import Health, ReceiveTimeout, StancePublisher, open_client, open_node

pytestmark = pytest.mark.slow

NODE = Path(__file__).with_name("publishing_node.py")


def ways(client: gp.TerrainClient, wait: float, **accepted: object) -> dict[str, Callable[[], object]]:
    """Methods that return a grid without waiting for a new one."""
    return {
        "latest": lambda: client.latest(**accepted),
        "latest map": lambda: client.latest(extent="map", **accepted),
        "query": lambda: client.query(timeout=5.0, **accepted),
        "stream": lambda: next(client.stream(wait, **accepted)),
        "stream map": lambda: next(client.stream(wait, "map", **accepted)),
        "wait_for_step": lambda: client.wait_for_step(1, wait, **accepted),
        "wait_for_step map": lambda: client.wait_for_step(1, wait, "map", **accepted),
        "regions": lambda: client.regions(wait, **accepted),
        "summary": lambda: client.summary(wait, **accepted),
    }


ALL = list(ways(None, 0.0))


def handed_out(client: gp.TerrainClient, wait: float = 0.5, **accepted: object) -> list[str]:
    """Methods that return a grid within a time [s]."""
    had = []
    for way, ask in ways(client, wait, **accepted).items():
        try:
            ask()
        except (gp.StaleTerrain, gp.ScannerUnavailable, gp.ScannerGone, ReceiveTimeout):
            continue
        had.append(way)
    return had


@pytest.fixture
def begin_node(start: Callable, free_endpoint: str, terrain_file: Path) -> Iterator[Callable]:
    """Start a node on a permanent router; kill the previous one with SIGKILL."""
    living: list = []

    def begin() -> object:
        node = start(NODE, free_endpoint, "guara", terrain_file, "connect")
        assert node.line() == "ready"
        living.append(node)
        return node

    with open_node(listen=free_endpoint):
        yield begin
        for node in living:
            node.popen.kill()


@pytest.fixture
def scanned(
    begin_node: Callable, free_endpoint: str
) -> Iterator[tuple[object, gp.TerrainClient, list[tuple[str, int]]]]:
    """Node that has scanned pause 1, a planner that has received its grids in every way, and the results of its
    callbacks.
    """
    node = begin_node()
    with gp.TerrainClient(free_endpoint, timeout=180) as client:
        heard: list[tuple[str, int]] = []
        for extent in ("footprint", "map"):
            client.on_terrain(lambda grid: heard.append((grid.extent, grid.step)), extent)
        with pytest.raises(ReceiveTimeout):
            client.summary(0.1)
        node.tell("pause 1 walk-a")
        node.tell("publish 1 0 walk-a provisional")
        node.tell("map 1 walk-a provisional")
        for extent in ("footprint", "map"):
            assert client.wait_for_step(1, 180, extent).is_provisional
        client.summary(180)
        client.regions(180)
        assert handed_out(client, 60.0) == ALL
        yield node, client, heard


def confirm(node: object, client: gp.TerrainClient) -> None:
    """Send END instead of BEGIN, which confirms the grids."""
    node.tell("end")
    node.tell("publish 1 0 walk-a")
    node.tell("map 1 walk-a")
    for extent in ("footprint", "map"):
        assert not client.wait_for_step(1, 180, extent, confirmed_only=True).is_provisional
    assert handed_out(client, 60.0) == ALL


def kill(node: object, client: gp.TerrainClient, eventually: Callable) -> None:
    node.popen.kill()
    assert eventually(lambda: not client.is_alive)


@pytest.mark.parametrize("then", ["pause 2 walk-a", "pause 49 walk-a", "pause 1 walk-b", ""])
def test_a_new_node_without_grids_brings_none_of_the_dead_one(
    scanned: tuple, begin_node: Callable, eventually: Callable, then: str
) -> None:
    """Killed in the swing after pause 1; then the next pause, 48 pauses, another walk, or no announcement."""
    node, client, heard = scanned
    confirm(node, client)
    kill(node, client, eventually)
    assert handed_out(client, max_age=1e9) == []
    new = begin_node()
    assert eventually(lambda: client.is_alive)
    if then:
        new.tell(then)
        step = then.split()[1]
        assert eventually(lambda: client.status().item("transport").values["step"] == step)
    before = len(heard)
    assert handed_out(client) == handed_out(client, max_age=1e9) == []
    assert len(heard) == before
    stale = client.latest(allow_stale=True)
    assert stale.step == 1 and "taken over since" in "".join(stale.stale_because)
    with pytest.raises(gp.StaleTerrain, match="taken over since"):
        stale.best_foothold(0.7, 0.1, radius=0.05)
    stale.best_foothold(0.7, 0.1, radius=0.05, allow_stale=True)
    new.tell("pause 60 walk-a")
    new.tell("publish 60 0 walk-a")
    new.tell("map 60 walk-a")
    for extent in ("footprint", "map"):
        assert client.wait_for_step(60, 180, extent).step == 60


def test_a_provisional_grid_of_a_killed_node_is_stale_at_once(
    scanned: tuple, begin_node: Callable, eventually: Callable
) -> None:
    """END is missed while the camera moves; the restarted node knows only that the robot walks."""
    node, client, _ = scanned
    kill(node, client, eventually)
    assert handed_out(client, max_age=1e9) == []
    with pytest.raises(gp.StaleTerrain, match="its node is gone"):
        client.latest(max_age=1e9)
    new = begin_node()
    new.tell("pause 1 walk-a")
    new.tell("end")
    assert eventually(lambda: client.status().item("transport").values["standing"] == "false")
    assert handed_out(client, max_age=1e9) == []


def test_a_node_that_hangs_is_told_and_vouches_for_nothing(scanned: tuple, eventually: Callable) -> None:
    """Stopped with SIGSTOP: the status is STALE after three seconds, and its grids may no longer be used."""
    node, client, _ = scanned
    confirm(node, client)
    assert client.status().item("node") is None
    node.popen.send_signal(signal.SIGSTOP)
    try:
        assert eventually(lambda: client.status().item("node") is not None)
        assert client.status().level is Health.STALE and "silent" in client.status().item("node").message
        assert handed_out(client, max_age=1e9) == []
    finally:
        node.popen.send_signal(signal.SIGCONT)
    assert eventually(lambda: client.is_alive and client.status().item("node") is None)
    assert client.wait_for_step(1, 180).step == 1


def test_a_node_that_no_longer_hears_the_gait_vouches_for_nothing(
    scanned: tuple, free_endpoint: str, eventually: Callable
) -> None:
    """Gait or link is lost: the next pause may have begun unnoticed. Once it is received again, grids are valid."""
    node, client, _ = scanned

    def said() -> str:
        return client.status().item("transport").values["gait"]

    node.tell("gait")
    with open_client(free_endpoint) as session:
        gait = StancePublisher(session)
        assert eventually(lambda: said() == "heard")
        confirm(node, client)
        gait.close()
    assert eventually(lambda: said() == "silent")
    assert handed_out(client, max_age=1e9) == []
    assert "has lost the gait controller" in "".join(client.latest(allow_stale=True).stale_because)
    with open_client(free_endpoint) as session:
        StancePublisher(session)
        assert eventually(lambda: said() == "heard")
        assert handed_out(client, 60.0) == ALL
