"""Publisher of views for people: the points of the last scan and a picture of the camera."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from transport.keys import DEFAULT_ROBOT, picture_key, points_key
from transport.links.outbox import Outbox
from transport.links.publisher import LARGEST, Publisher
from transport.links.session import Resource, Session
from transport.messages.codec import encode
from transport.messages.encodings import cdr
from transport.messages.typestore import COMPRESSED_IMAGE, POINT_CLOUD


class ViewSender(Resource):
    """Publishes points and picture of each scan at the lowest priority; late subscribers get the last."""

    def __init__(self, session: Session, *, robot: str = DEFAULT_ROBOT) -> None:
        """Declare the keys.

        Raises:
            SessionClosed: the session is closed.
        """
        self._outbox = Outbox()
        self._publishers = {
            kind: Publisher(session, key, priority=LARGEST, encoding=cdr(kind))
            for kind, key in ((POINT_CLOUD, points_key(robot)), (COMPRESSED_IMAGE, picture_key(robot)))
        }
        super().__init__(session)

    def send(self, make: Callable[[], Iterable[Any]]) -> None:
        """Send message objects, sensor_msgs/PointCloud2 and sensor_msgs/CompressedImage; returns at once.

        Args:
            make: returns the message objects; called on a thread of its own, only the newest if several wait.
        """

        def put() -> None:
            for message in make():
                self._publishers[message.__msgtype__].put(encode(message))

        self._outbox.post("views", put)

    def flush(self, timeout: float) -> None:
        """Wait until all is sent; ReceiveTimeout when that takes longer than `timeout` [s]."""
        self._outbox.flush(timeout)

    def _release(self) -> None:
        self._outbox.close()
        for publisher in self._publishers.values():
            publisher.close()
