"""Publisher of messages for viewers: points, camera image and range images of the last scan."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import Any

from transport.keys import DEFAULT_ROBOT, RANGE_IMAGES, perception_key, picture_key, points_key
from transport.links.publisher import LARGEST, Publisher, Sender
from transport.links.session import Session
from transport.messages.codec import encode
from transport.messages.typestore import COMPRESSED_IMAGE, IMAGE, POINT_CLOUD, cdr


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
