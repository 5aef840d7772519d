"""Planner's client with a node in another process, over real Zenoh."""

import math
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

import guara_perception as gp
from transport import ConnectionFailed, KeyNameError, ReceiveTimeout

pytestmark = pytest.mark.slow

NODE = Path(__file__).with_name("publishing_node.py")


@pytest.fixture(scope="module")
def node(start, module_endpoint: str, terrain_file: Path):
    """Node that publishes on command; steps increase through the module."""
    process = start(NODE, module_endpoint, "guara", terrain_file)
    assert process.line() == "ready"
    return process


@pytest.fixture
def client(node, module_endpoint: str) -> Iterator[gp.TerrainClient]:
    """Planner connected to it."""
    with gp.TerrainClient(module_endpoint, timeout=180) as connected:
        yield connected


def test_running_node_without_a_grid_is_reported(client: gp.TerrainClient, eventually: Callable):
    """Alive, but nothing published yet: stale, with the reason. Runs first, before anything is published."""
    assert eventually(lambda: client.is_alive)
    with pytest.raises(gp.StaleTerrain, match="has not published a footprint grid yet"):
        client.latest()


def test_late_joiner_gets_the_last_grid_bit_for_bit(node, module_endpoint: str, paper_terrain: gp.TerrainGrid):
    """A planner that starts after the scan receives the grid at once, with all bits and metadata."""
    node.tell("publish 1")
    with gp.TerrainClient(module_endpoint, timeout=180) as late:
        terrain = late.wait_for_step(1, timeout=180)
        assert late.latest().step == 1
    for name, layer in paper_terrain.layers.items():
        assert terrain.layer(name).tobytes() == layer.tobytes(), name
        assert not terrain.layer(name).flags.writeable
    assert terrain.origin == paper_terrain.origin and terrain.resolution == paper_terrain.resolution
    assert (terrain.frame, terrain.extent) == ("base_footprint", "footprint")
    reported = {name: terrain.metadata[name] for name in paper_terrain.metadata}
    assert reported == dict(paper_terrain.metadata)


def test_wait_for_step_returns_that_step_or_a_later_one(node, client: gp.TerrainClient):
    """A planner that missed a step receives the newer grid, never an older one."""
    node.tell("publish 4")
    node.tell("publish 6")
    assert client.wait_for_step(6, timeout=180).step == 6
    assert client.wait_for_step(3, timeout=180).step == 6
    with pytest.raises(ReceiveTimeout, match="within 0.3 s"):
        client.wait_for_step(7, timeout=0.3)
    for step in (math.nan, "6"):
        with pytest.raises(ValueError, match="allowed: a whole number"):
            client.wait_for_step(step, timeout=30)


def test_old_grid_is_stale(node, client: gp.TerrainClient):
    """Older than max_age or its own validity: refused with age, limit and remedy."""
    node.tell("publish 10 100")
    client.wait_for_step(10, timeout=180)
    assert client.latest().step == 10
    with pytest.raises(gp.StaleTerrain, match=r"step 10\) is 1\d\d\.\d+ s old; allowed: 50 s"):
        client.latest(max_age=50)
    assert client.latest(max_age=1000).step == 10
    node.tell("publish 11 5000")
    assert client.wait_for_step(11, timeout=30, max_age=math.inf).step == 11
    for ask in (client.latest, client.query):
        with pytest.raises(gp.StaleTerrain, match="allowed: 420 s.*request a scan"):
            ask()
    with pytest.raises(ReceiveTimeout, match="allowed: 420 s"):
        next(client.stream(timeout=0.3))
    assert next(client.stream(timeout=30, max_age=math.inf)).step == 11


def test_grid_of_many_pauses_ago_is_stale(node, client: gp.TerrainClient, eventually: Callable):
    """The robot walked on without a scan: the validity in pauses has ended, and max_age does not extend it."""
    node.tell("publish 20")
    node.tell("map 20")
    client.wait_for_step(20, timeout=180)
    client.wait_for_step(20, timeout=30, extent="map")

    def is_stale(extent: str, expected_text: str) -> bool:
        try:
            client.latest(extent=extent)
        except gp.StaleTerrain as error:
            return expected_text in str(error)
        return False

    node.tell("pause 21")
    assert eventually(lambda: is_stale("footprint", "1 pause old; allowed: 0"))
    assert client.latest(extent="map").step == 20
    node.tell("pause 70")
    assert eventually(lambda: is_stale("map", "50 pauses old; allowed: 40"))
    for extent in ("footprint", "map"):
        with pytest.raises(gp.StaleTerrain, match="50 pauses old"):
            client.latest(max_age=1000, extent=extent)
        terrain = client.latest(extent=extent, allow_stale=True)
        assert terrain.step == 20 and "50 pauses old" in terrain.stale_because[0]
        with pytest.raises(gp.StaleTerrain, match="50 pauses old"):
            terrain.is_traversable(0.7, 0.1)
        assert terrain.is_traversable(0.7, 0.1, allow_stale=True) in (True, False)
    node.tell("pause 71")


def test_callback_gets_the_newest_on_another_thread(node, client: gp.TerrainClient, eventually: Callable):
    """The callback runs on the client's thread and ends with the newest grid; steps never decrease."""
    heard: list[int] = []
    threads: set[int] = set()

    def callback(terrain: gp.TerrainGrid) -> None:
        heard.append(terrain.step)
        threads.add(threading.get_ident())

    client.on_terrain(callback)
    for step in range(80, 85):
        node.tell(f"publish {step}")
    assert eventually(lambda: bool(heard) and heard[-1] == 84)
    assert heard == sorted(heard)
    assert threading.get_ident() not in threads


def test_both_extents_are_received(node, client: gp.TerrainClient):
    """Footprint and map have separate keys."""
    node.tell("publish 90")
    node.tell("map 90")
    fused = client.wait_for_step(90, timeout=30, extent="map")
    assert fused.extent == "map" and client.latest(extent="map").step == 90
    assert client.wait_for_step(90, timeout=180).extent == "footprint"
    node.tell("map 91")
    client.wait_for_step(91, timeout=30, extent="map")
    with pytest.raises(gp.StaleTerrain, match="1 pause old"):
        client.latest()


def test_flipped_bit_is_refused_everywhere(node, client: gp.TerrainClient, eventually: Callable, caplog):
    """A safe cell with an additional flag violates the invariant: no method returns the grid."""
    node.tell("publish 100")
    client.wait_for_step(100, timeout=180)
    heard: list[int] = []
    client.on_terrain(lambda terrain: heard.append(terrain.step))
    assert eventually(lambda: heard == [100])
    node.tell("break 101")
    with pytest.raises(
        gp.UnsafeGrid, match="grid received from 'guara', step 101: a cell is traversable with a hazard"
    ):
        client.wait_for_step(101, timeout=180)
    with pytest.raises(gp.UnsafeGrid, match="1 cells, the first at iy="):
        client.latest()
    with pytest.raises(gp.UnsafeGrid):
        next(client.stream(timeout=180))
    assert eventually(lambda: "step 101" in caplog.text)
    node.tell("publish 102")
    assert client.wait_for_step(102, timeout=180).step == 102
    assert eventually(lambda: heard == [100, 102])


def test_stream_yields_newer_grids_only(node, client: gp.TerrainClient):
    """The stream begins with the last grid and then waits for the next."""
    node.tell("publish 110")
    client.wait_for_step(110, timeout=180)
    stream = client.stream(timeout=180)
    assert next(stream).step == 110
    node.tell("publish 111")
    assert next(stream).step == 111
    with pytest.raises(ReceiveTimeout):
        next(client_stream_after(client, 111))


def client_stream_after(client: gp.TerrainClient, step: int) -> Iterator[gp.TerrainGrid]:
    """Grids after `step`, with a short timeout for each."""
    return (terrain for terrain in client.stream(timeout=0.3) if terrain.step > step)


def test_query_returns_a_region(node, client: gp.TerrainClient, paper_terrain: gp.TerrainGrid):
    """A region of the newest grid is cut at cell borders and has the same values."""
    node.tell("publish 120")
    region = client.query(region=(0.60, 0.70, -0.10, 0.05), timeout=180)
    assert region.shape == (30, 20) and region.origin == pytest.approx((0.60, -0.10))
    np.testing.assert_array_equal(region.hazard, np.asarray(paper_terrain.hazard)[34:64, 20:40])


def test_requested_scan_comes_back_or_says_why_not(node, client: gp.TerrainClient):
    """A requested scan reports its progress and returns its grid; a failed one states the reason."""
    node.tell("serve")
    heard: list = []
    assert client.request_scan("standard", timeout=60, on_progress=heard.append).step == 1000
    assert heard
    with pytest.raises(gp.ScanFailed, match="the mirror did not move"):
        client.request_scan("coarse", timeout=60)


def test_counts_say_what_was_received(node, client: gp.TerrainClient):
    """Four counts by name: received, superseded, missed and rejected."""
    node.tell("publish 2000")
    client.wait_for_step(2000, timeout=180)
    counts = client.counts()
    assert set(counts) == {"received", "superseded", "missed", "rejected"}
    assert counts["received"] >= 1 and counts["rejected"] == 0


def test_other_robots_node_is_not_taken_for_ours(node, module_endpoint: str):
    """No grid and no node of this instance name: unavailable, with what to check."""
    with gp.TerrainClient(module_endpoint, robot="tapir", timeout=180) as client:
        with pytest.raises(gp.ScannerUnavailable, match="no node of robot 'tapir' was found"):
            client.latest()
        with pytest.raises(gp.ScannerUnavailable):
            client.wait_for_step(1, timeout=0.3)


def test_nobody_there(free_endpoint: str):
    """No listener: one error that lists what to check."""
    with pytest.raises(ConnectionFailed, match="is the node running"):
        gp.TerrainClient(free_endpoint, timeout=0.5)


def test_bad_name_is_refused_before_anything_is_opened(free_endpoint: str):
    """An invalid robot name is refused at once, with or without a node."""
    with pytest.raises(KeyNameError, match="robot name 'a/b' cannot be part of a key"):
        gp.TerrainClient(free_endpoint, robot="a/b", timeout=180)


def test_node_that_dies_is_noticed(start, free_endpoint: str, terrain_file: Path, eventually: Callable):
    """The last grid can be read while it is valid; waiting for the next raises ScannerGone."""
    mortal = start(NODE, free_endpoint, "guara", terrain_file)
    assert mortal.line() == "ready"
    mortal.tell("publish 5")
    with gp.TerrainClient(free_endpoint, timeout=180) as client:
        assert client.wait_for_step(5, timeout=180).step == 5
        assert eventually(lambda: client.is_alive)
        mortal.popen.kill()
        assert eventually(lambda: not client.is_alive)
        assert client.latest().step == 5
        with pytest.raises(gp.StaleTerrain, match="its node is gone"):
            client.latest(max_age=0.0)
        with pytest.raises(gp.ScannerUnavailable, match="disappeared") as error:
            client.wait_for_step(6, timeout=0.3)
        assert error.type is gp.ScannerGone
