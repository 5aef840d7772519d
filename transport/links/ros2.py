"""Bridge to ROS 2: publishes messages as rmw_zenoh does, so that ROS 2 nodes can subscribe to them."""

from __future__ import annotations

import struct
import threading
import time

from transport.exceptions import ConfigurationError
from transport.keys import DEFAULT_ROBOT, check_name
from transport.links.liveliness import AliveToken
from transport.links.publisher import Publisher
from transport.links.session import Resource, Session
from transport.messages.typestore import GRID_MAP, OCCUPANCY, cdr, dds_type_name, type_hash

# Name of the node in ROS 2 tools.
NODE_NAME = "guara_perception"

# Quality of service: reliable, transient local, keep last 1, otherwise defaults.
QOS = ":1:,1:,:,:,,"

# Largest ROS 2 domain id.
MAXIMUM_DOMAIN = 232

NODE_ID = 0
FIRST_ENTITY_ID = 10


def data_key(domain: int, topic: str, type_name: str) -> str:
    """Key of a topic in rmw_zenoh; `topic` has no leading slash."""
    return f"{domain}/{topic}/{dds_type_name(type_name)}/{type_hash(type_name)}"


def node_token_key(domain: int, zenoh_id: str) -> str:
    """Key of the liveliness token that represents this node in ROS 2."""
    return f"@ros2_lv/{domain}/{zenoh_id}/{NODE_ID}/{NODE_ID}/NN/%/%/{NODE_NAME}"


def publisher_token_key(domain: int, zenoh_id: str, entity_id: int, topic: str, type_name: str) -> str:
    """Key of the liveliness token that represents a publisher in ROS 2; `topic` has no leading slash."""
    mangled = "%" + topic.replace("/", "%")
    return (
        f"@ros2_lv/{domain}/{zenoh_id}/{NODE_ID}/{entity_id}/MP/%/%/{NODE_NAME}/{mangled}/"
        f"{dds_type_name(type_name)}/{type_hash(type_name)}/{QOS}"
    )


def publisher_id(token_key: str) -> bytes:
    """Identity of a publisher in rmw_zenoh: 128-bit XXH3 hash of its token's key, little endian."""
    import xxhash

    return bytes(xxhash.xxh3_128_intdigest(token_key.encode()).to_bytes(16, "little"))


def make_attachment(sequence: int, stamp: int, identity: bytes) -> bytes:
    """Make the attachment of an rmw_zenoh sample: sequence number from 1, time [ns], length of identity, identity."""
    return struct.pack("<qqB", sequence, stamp, len(identity)) + identity


class Ros2Bridge(Resource):
    """Publisher of topics for ROS 2 nodes that use rmw_zenoh: reliable, and transient local for late subscribers.

    The topics `/<robot>/occupancy` and `/<robot>/grid_map` are declared on creation, others with their first message.
    """

    def __init__(self, session: Session, *, robot: str = DEFAULT_ROBOT, domain: int = 0) -> None:
        """Declare the ROS 2 node and its first two topics.

        Raises:
            ConfigurationError: the domain is not valid, or the robot's name cannot be part of a ROS 2 topic.
            KeyNameError: the robot's name cannot be part of a key.
            SessionClosed: the session is closed.
        """
        if not 0 <= domain <= MAXIMUM_DOMAIN:
            raise ConfigurationError(f"ROS domain is {domain}; allowed: 0 to {MAXIMUM_DOMAIN}")
        check_name(robot)
        if "-" in robot or robot[0].isdigit():
            raise ConfigurationError(
                f"robot name {robot!r} cannot be part of a ROS 2 topic; use only letters, digits and '_', not starting "
                "with a digit"
            )
        self._robot, self._domain = robot, domain
        self._bridged, self._lock = session, threading.Lock()
        self._node = AliveToken(session, node_token_key(domain, session.zenoh_id))
        self._topics: dict[str, tuple[Publisher, AliveToken]] = {}
        for name, type_name in (("occupancy", OCCUPANCY), ("grid_map", GRID_MAP)):
            self._topic(f"{robot}/{name}", type_name)
        super().__init__(session)

    def put(self, name: str, type_name: str, payload: bytes | bytearray) -> None:
        """Send a CDR payload on a topic; a topic that does not exist yet is declared first.

        Args:
            name: name of the topic below `/<robot>/`, or the full name with a leading slash.
            type_name: message type of the topic, such as `nav_msgs/msg/OccupancyGrid`.
            payload: CDR payload of that type.

        Raises:
            MessageError: the type is not known.
            SessionClosed: the session is closed.
        """
        topic = name[1:] if name.startswith("/") else f"{self._robot}/{name}"
        self._topic(topic, type_name).put(payload)

    def _topic(self, name: str, type_name: str) -> Publisher:
        with self._lock:
            if name not in self._topics:
                session, entity_id = self._bridged, FIRST_ENTITY_ID + len(self._topics)
                token_key = publisher_token_key(self._domain, session.zenoh_id, entity_id, name, type_name)
                identity, key = publisher_id(token_key), data_key(self._domain, name, type_name)

                def attach(number: int) -> bytes:
                    return make_attachment(number + 1, time.time_ns(), identity)

                publisher = Publisher(session, key, encoding=cdr(type_name), stamped=True, attach=attach)
                self._topics[name] = publisher, AliveToken(session, token_key)
            return self._topics[name][0]

    def _release(self) -> None:
        for publisher, token in self._topics.values():
            token.close()
            publisher.close()
        self._node.close()
