"""Points and pictures for views, from a node to a receiver over real Zenoh."""

import numpy as np

from tests import ports
from transport import open_client, open_node, point_cloud_message
from transport.grids.grid_publishers import ViewSender
from transport.keys import picture_key, points_key
from transport.links.receiver import NewestReceiver
from transport.messages.codec import decode, read_time
from transport.messages.typestore import COMPRESSED_IMAGE, POINT_CLOUD
from transport.recording import FrameRecord
from transport.recording.records import make_frame


def test_who_joins_later_gets_the_last_of_both() -> None:
    """Sent before anybody listened, and again while somebody does."""
    endpoint = ports.free_endpoint()
    with open_node(listen=endpoint) as node:
        views = ViewSender(node, robot="lobo")

        def messages(stamp: int) -> tuple[object, object]:
            xyz = {name: np.full(5, stamp, np.float32) for name in "xyz"}
            frame = FrameRecord(data=b"jpeg", format="jpeg", stamp=stamp)
            return point_cloud_message(xyz, "base_footprint", stamp), make_frame(frame, stamp)

        views.send(lambda: messages(1))
        views.flush(30)
        with open_client(endpoint) as client:
            points = NewestReceiver(client, points_key("lobo"), lambda payload: decode(payload, POINT_CLOUD))
            pictures = NewestReceiver(client, picture_key("lobo"), lambda payload: decode(payload, COMPRESSED_IMAGE))
            assert read_time(points.wait_for(lambda _: True, 30).message.header.stamp) == 1
            assert pictures.wait_for(lambda _: True, 30).message.data.tobytes() == b"jpeg"
            views.send(lambda: messages(2))
            views.flush(30)
            assert points.wait_for(lambda cloud: read_time(cloud.header.stamp) == 2, 30).message.width == 5
            pictures.wait_for(lambda picture: read_time(picture.header.stamp) == 2, 30)
