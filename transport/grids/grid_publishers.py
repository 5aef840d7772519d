"""Publishers of a node's grids, of all messages derived from them, and of what viewers show of the last scan."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import Any

import numpy as np

from transport.arrays import Percent
from transport.keys import (
    DEFAULT_ROBOT,
    RANGE_IMAGES,
    grid_map_key,
    occupancy_key,
    perception_key,
    picture_key,
    points_key,
    regions_key,
    summary_key,
    terrain_key,
)
from transport.links.last_message import MadeOnce, Payload
from transport.links.outbox import Outbox
from transport.links.publisher import LARGE, LARGEST, SMALL, Publisher, Sender
from transport.links.ros2 import Ros2Bridge
from transport.links.session import Session
from transport.messages.codec import encode
from transport.messages.map_messages import RegionsMessage, encode_regions
from transport.messages.standard import grid_map_message, occupancy_message
from transport.messages.terrain_message import EXTENTS, LAYERS, TerrainMessage, encode_compact, encode_terrain
from transport.messages.typestore import (
    COMPRESSED_IMAGE,
    GRID_MAP,
    IMAGE,
    OCCUPANCY,
    POINT_CLOUD,
    REGIONS,
    SUMMARY,
    TERRAIN,
    cdr,
    compact,
)

# Layers of the GridMap, whose values are all float32: the float32 layers except `ceiling`, and the hazard flags, which
# are exact in float32 because they are below 2^24.
GRID_MAP_LAYERS = (*(name for name, kind in LAYERS.items() if kind.dtype == np.float32 and name != "ceiling"), "hazard")


class GridPublishers:
    """Publishers that encode and send on threads of the outbox; footprint grids and maps do not wait for each other."""

    def __init__(self, session: Session, robot: str, outbox: Outbox) -> None:
        """Declare the keys.

        Args:
            session: open session of the node.
            robot: instance name.
            outbox: outbox of the node; its owner closes it before these publishers.

        Raises:
            KeyNameError: the robot name cannot be part of a key.
            SessionClosed: the session is closed.
        """
        self._outbox = outbox

        def latched(key: str, encoding: str, priority: str) -> Publisher:
            """Make a publisher that keeps its last message for late subscribers and queries."""
            return Publisher(session, key, priority=priority, encoding=encoding, answers=True)

        self._terrain = {
            extent: latched(terrain_key(robot, extent), cdr(TERRAIN), LARGEST if extent == "map" else LARGE)
            for extent in EXTENTS
        }
        self._compact = {
            extent: latched(terrain_key(robot, extent, "compact"), compact(TERRAIN), LARGE) for extent in EXTENTS
        }
        self._occupancy = latched(occupancy_key(robot), cdr(OCCUPANCY), SMALL)
        self._grid_map = latched(grid_map_key(robot), cdr(GRID_MAP), LARGEST)
        # Not latched: routers may drop summaries on purpose, and readers of a latched key would fetch the dropped ones.
        self._summary = Publisher(session, summary_key(robot), latched=False, encoding=cdr(SUMMARY))
        self._regions = latched(regions_key(robot), cdr(REGIONS), SMALL)

    @property
    def count(self) -> int:
        """Number of grids that have been published."""
        return sum(publisher.count for publisher in self._terrain.values())

    def post(
        self,
        terrain: TerrainMessage,
        summary: Callable[[], Payload] | None,
        regions: Callable[[], RegionsMessage] | None,
    ) -> None:
        """Publish a grid and, for a map, its summary and regions; arguments as in `PerceptionServer.publish`."""
        publisher, lane = self._terrain[terrain.extent], terrain.extent
        self._outbox.post(publisher.key, lambda: publisher.put(encode_terrain(terrain)), lane=lane)
        small = self._compact[terrain.extent]
        # The compact form is encoded only for subscribers and queries: it takes 20 times as long as the lossless form.
        self._outbox.post(small.key, lambda: small.put(lambda: encode_compact(terrain)), lane=lane)
        if summary is not None:
            self._outbox.post(self._summary.key, partial(self._summary.put, summary), lane=self._summary.key)
        if regions is not None:
            # Regions, too, are computed only for subscribers and queries: this takes about as long as fusing the map.
            self._outbox.post(
                self._regions.key,
                lambda: self._regions.put(lambda: encode_regions(regions())),
                lane=self._regions.key,
            )

    def close(self) -> None:
        """Undeclare the keys."""
        others = self._occupancy, self._grid_map, self._summary, self._regions
        for publisher in (*self._terrain.values(), *self._compact.values(), *others):
            publisher.close()

    def post_derived(self, terrain: TerrainMessage, occupancy: Percent, bridge: Ros2Bridge | None) -> None:
        """Publish occupancy and grid map of a footprint grid, also on ROS 2 topics if there is a `bridge`."""
        geometry = (terrain.resolution, terrain.origin, terrain.frame_id, terrain.stamp)
        layers = {name: terrain.layers[name] for name in GRID_MAP_LAYERS}
        # These messages are encoded only for subscribers, queries and the bridge, because planners do not read them.
        for publisher, name, kind, make in (
            (self._occupancy, "occupancy", OCCUPANCY, lambda: encode(occupancy_message(occupancy, *geometry))),
            (self._grid_map, "grid_map", GRID_MAP, lambda: encode(grid_map_message(layers, *geometry))),
        ):
            send = partial(_send, publisher, MadeOnce(make), bridge, name, kind)
            self._outbox.post(publisher.key, send, lane=terrain.extent)


def _send(publisher: Publisher, made: MadeOnce, bridge: Ros2Bridge | None, name: str, kind: str) -> None:
    """Publish a message on the publisher's key, and on a ROS 2 topic if there is a bridge."""
    publisher.put(made)
    if bridge is not None:
        bridge.put(name, kind, made())


class ViewSender(Sender):
    """Publisher of points, camera image and range images at the lowest priority; the last message of each is kept."""

    def __init__(self, session: Session, *, robot: str = DEFAULT_ROBOT) -> None:
        """Declare the keys.

        Raises:
            KeyNameError: the robot name cannot be part of a key.
            SessionClosed: the session is closed.
        """
        keys = {
            POINT_CLOUD: (points_key(robot), POINT_CLOUD),
            COMPRESSED_IMAGE: (picture_key(robot), COMPRESSED_IMAGE),
            **{name: (perception_key(name, robot), IMAGE) for name in RANGE_IMAGES},
        }
        self._publishers = {
            name: Publisher(session, key, priority=LARGEST, encoding=cdr(kind)) for name, (key, kind) in keys.items()
        }
        super().__init__(session, *self._publishers.values())

    def send(self, make: Callable[[], Iterable[Any]]) -> None:
        """Send sensor_msgs/PointCloud2 and sensor_msgs/CompressedImage message objects; returns immediately.

        Args:
            make: returns the message objects; called on a thread of the outbox. A newer call replaces a waiting one.
        """

        def put() -> None:
            for message in make():
                self._publishers[message.__msgtype__].put(encode(message))

        self._outbox.post("views", put)

    def send_range_images(self, make: Callable[[], Mapping[str, Any]]) -> None:
        """Send the sensor_msgs/Image message objects of RANGE_IMAGES; returns immediately.

        Args:
            make: returns the message objects by name; called once for each image that has subscribers or is queried.
        """

        def payload(name: str) -> bytearray:
            return encode(make()[name])

        def put() -> None:
            for name in RANGE_IMAGES:
                self._publishers[name].put(partial(payload, name))

        self._outbox.post("range images", put)
