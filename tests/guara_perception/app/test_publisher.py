"""Publishing a grid: what ROS 2 tools read holds the same cells in their own order."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import guara_perception as gp
from transport import NewestReceiver, Session, decode, open_client
from transport.keys import grid_map_key, occupancy_key

NODE = Path(__file__).with_name("publishing_node.py")


@pytest.fixture
def session(start, free_endpoint: str, terrain_file: Path) -> Iterator[Session]:
    """A client of a node that has published one footprint and then one map."""
    node = start(NODE, free_endpoint, "guara", terrain_file)
    assert node.line() == "ready"
    node.tell("publish 3")
    node.tell("map 4")
    with open_client(free_endpoint, timeout=180) as opened:
        yield opened


def received(session: Session, key: str, kind: str):
    """The latched message of a key."""
    return NewestReceiver(session, key, lambda raw: decode(raw, kind)).wait_for(lambda _: True, 30).message


def test_derived_grids_are_those_of_the_footprint(session: Session, paper_terrain: gp.TerrainGrid):
    """Occupancy runs from minimum x and y, GridMap from maximum x and y; both are of the scan, not of the map."""
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
