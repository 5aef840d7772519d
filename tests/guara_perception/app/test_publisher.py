"""Publication of a grid: messages for ROS 2 tools contain the same cells in their own order."""

import dataclasses
import time
from collections.abc import Iterator
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest

import guara_perception as gp
from kinematics import LegOdometry, RobotModel
from transport import KeyNameError, NameTaken, NewestReceiver, Session, SessionClosed, decode, open_client
from transport.keys import grid_map_key, occupancy_key

NODE = Path(__file__).with_name("publishing_node.py")


@pytest.fixture
def session(start, free_endpoint: str, terrain_file: Path) -> Iterator[Session]:
    """Client of a node that has published a footprint and then a map."""
    node = start(NODE, free_endpoint, "guara", terrain_file)
    assert node.line() == "ready"
    node.tell("publish 3")
    node.tell("map 4")
    with open_client(free_endpoint, timeout=180) as opened:
        yield opened


def received(session: Session, key: str, kind: str):
    """Latched message of a key."""
    return NewestReceiver(session, key, lambda raw: decode(raw, kind)).wait_for(lambda _: True, 30).message


def test_derived_grids_are_those_of_the_footprint(session: Session, paper_terrain: gp.TerrainGrid):
    """Occupancy starts at minimum x and y, GridMap at maximum x and y; both are of the scan, not of the map."""
    occupancy = received(session, occupancy_key(), "nav_msgs/msg/OccupancyGrid")
    assert (occupancy.info.width, occupancy.info.height) == (90, 108)
    assert occupancy.info.resolution == pytest.approx(0.005)
    assert (occupancy.info.origin.position.x, occupancy.info.origin.position.y) == pytest.approx((0.50, -0.27))
    np.testing.assert_array_equal(occupancy.data, paper_terrain.to_occupancy().ravel())
    assert len(np.unique(occupancy.data)) > 2

    grid_map = received(session, grid_map_key(), "grid_map_msgs/msg/GridMap")
    for name in ("elevation", "traversability"):
        data = grid_map.data[grid_map.layers.index(name)].data
        np.testing.assert_array_equal(data, paper_terrain.layer(name)[::-1, ::-1].ravel())
    # The centre of the GridMap is the centre of the area.
    centre = grid_map.info.pose.position
    assert (centre.x, centre.y) == pytest.approx((0.725, 0.0))


@pytest.mark.slow
def test_a_grid_of_ones_own_goes_out_under_a_name_of_its_own(session: Session) -> None:
    """Beside a node, in its session and under another name; each grid replaces the previous one."""
    points = [[x, y, 0.0] for x in np.arange(0.5025, 0.95, 0.005) for y in np.arange(-0.2675, 0.27, 0.005)]
    with gp.TerrainClient(session.endpoints[0], robot="guara_own", timeout=180) as client:
        for step in (1, 2):
            terrain = gp.terrain_from_points(points, 0.001, (0.4, 0.0, 0.5), stamp=time.time_ns(), step=step)
            gp.publish_terrain(session, terrain)
            received = client.wait_for_step(step, timeout=60)
            np.testing.assert_array_equal(received.hazard, terrain.hazard)
        assert client.latest().step == 2 and client.latest().is_traversable(0.7, 0.0)
    with pytest.raises(NameTaken):
        gp.publish_terrain(session, terrain, "guara")
    with pytest.raises(KeyNameError):
        gp.publish_terrain(session, terrain, "no/name")


@pytest.mark.slow
def test_a_grid_of_ones_own_that_is_unsafe_or_none_is_not_sent(session: Session, paper_terrain: gp.TerrainGrid) -> None:
    """The invariant is checked before sending; nothing arrives, and the next grid does."""
    iy, ix = np.argwhere(paper_terrain.hazard != 0)[0]
    score = paper_terrain.traversability.copy()
    score[iy, ix] = 0.5
    unsafe = dataclasses.replace(paper_terrain, step=7)
    object.__setattr__(unsafe, "layers", MappingProxyType({**paper_terrain.layers, "traversability": score}))
    with gp.TerrainClient(session.endpoints[0], robot="guara_own", timeout=180) as client:
        with pytest.raises(gp.UnsafeGrid, match="a cell is traversable with a hazard"):
            gp.publish_terrain(session, unsafe)
        with pytest.raises(gp.InvalidInput, match="terrain is a ndarray; allowed: a TerrainGrid"):
            gp.publish_terrain(session, paper_terrain.elevation)  # type: ignore[arg-type]
        with pytest.raises(
            gp.InvalidInput, match=r"session is a builtins\.Session; allowed: one of transport\.open_client"
        ):
            gp.publish_terrain(session.raw, paper_terrain)
        old = dataclasses.replace(paper_terrain, step=7, stamp=time.time_ns(), extent="map", stale_because=("old",))
        with pytest.raises(gp.StaleTerrain):
            gp.publish_terrain(session, old)
        gp.publish_terrain(session, dataclasses.replace(paper_terrain, step=8, stamp=time.time_ns()))
        assert client.wait_for_step(7, timeout=60).step == 8


@pytest.mark.slow
def test_a_map_of_ones_own_goes_out_and_a_closed_session_says_so(
    session: Session, robot: RobotModel, paper_scan: gp.Scan, paper_terrain: gp.TerrainGrid
) -> None:
    """Either extent; once the session is closed, nothing is published."""
    now = dataclasses.replace(paper_terrain, stamp=time.time_ns())
    fused = gp.TerrainMap(robot).update(now, LegOdometry(robot).update(paper_scan.stance))
    with gp.TerrainClient(session.endpoints[0], robot="sensor", timeout=180) as client:
        gp.publish_terrain(session, fused, "sensor")
        received = client.wait_for_step(fused.step, timeout=60, extent="map")
    np.testing.assert_array_equal(received.hazard, fused.hazard)
    session.close()
    with pytest.raises(SessionClosed):
        gp.publish_terrain(session, fused, "sensor")
