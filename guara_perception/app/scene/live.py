"""Live messages of each pause: points and a camera image for viewers, and the scene for ROS 2."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from guara_perception.app.scene.scene import Named, Scene, stripe_cloud
from guara_perception.arrays import Image
from guara_perception.images import for_screen
from kinematics import BASE_FOOTPRINT, Stance
from transport import TerrainMessage, point_cloud_message
from transport.grids.grid_publishers import ViewSender
from transport.recording import FrameRecord
from transport.recording.records import make_frame
from transport.server import PerceptionServer

if TYPE_CHECKING:
    from drivers import StripeCapture
    from guara_perception.ranging.stripe_points import StripePoints

# Every third point, and camera images of at most this width, are enough for a display.
THINNED = 3
PICTURE_WIDTH_PX = 480
JPEG_QUALITY = 80
# Besides the first image, only images of stripes within this distance of the median are copied [stripe indices].
NEAR = 2
# Topics that a robot usually publishes itself; they are sent only on request.
OF_THE_ROBOT = ("/tf", "/tf_static", "/robot_description")


class LiveView:
    """Sender of the points and one camera image of each scan to viewers; it does not block the scan."""

    def __init__(self, views: ViewSender, centre: int) -> None:
        """Start without an image.

        Args:
            views: sender of the messages.
            centre: median index of the pattern; the stripe nearest to it within NEAR is shown, else the first one.
        """
        self._views, self._centre = views, centre
        self._seen: tuple[int, Image] | None = None

    def begin(self) -> None:
        """Discard the image of the previous scan."""
        self._seen = None

    def add(self, capture: StripeCapture) -> None:
        """Keep the image of a stripe if it is the first, or near the median stripe and the nearest to it so far."""
        off = abs(capture.index - self._centre)
        is_nearer = self._seen is None or (off <= NEAR and off < self._seen[0])
        if capture.on is not None and is_nearer:
            self._seen = off, capture.on.copy()

    def send(self, points: Mapping[int, StripePoints], stamp: int) -> None:
        """Send the points of the stripes, by index, and the image, both of the scan that ended at `stamp` [ns]."""
        kept, seen = dict(points), self._seen
        self._views.send(lambda: _messages(kept, seen, stamp))


def _messages(points: Mapping[int, StripePoints], seen: tuple[int, Image] | None, stamp: int) -> Iterator[Any]:
    cloud = stripe_cloud(points)
    thinned = {name: np.ascontiguousarray(cloud[name][::THINNED]) for name in ("x", "y", "z")}
    yield point_cloud_message(thinned, BASE_FOOTPRINT, stamp)
    if seen is not None:
        small = for_screen(seen[1], PICTURE_WIDTH_PX)
        data = cv2.imencode(".jpg", small, (cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY))[1].tobytes()
        yield make_frame(FrameRecord(data=data, format="jpeg", stamp=stamp), stamp)


class SceneMirror:
    """Sender of scenes to ROS 2, over the server's bridge.

    Methods return immediately; the server's threads make the messages.
    """

    def __init__(self, server: PerceptionServer, scene: Scene, *, unknown: int = 100, with_tf: bool = False) -> None:
        """Send the messages of every grid that the server publishes from now on.

        Args:
            server: server with a ROS 2 bridge; without one nothing is computed.
            scene: source of the messages.
            unknown: value of unknown cells in occupancy grids, 100 or -1.
            with_tf: also send the robot itself (`/<robot>/tf`, `/<robot>/tf_static`, `/<robot>/robot_description`).
        """
        self._server, self._scene, self._unknown, self._with_tf = server, scene, unknown, with_tf
        server.draw_with(self._of_grid)
        if with_tf:
            server.mirror(lambda: self._named(scene.unchanging(time.time_ns())), lane="robot")

    def begin(self, stance: Stance, stamp: int) -> None:
        """Send the camera model at the beginning of a scan and, with `with_tf`, the robot's frames."""
        self._server.mirror(lambda: self._named(self._scene.of_stance(stance, stamp)), lane="stance")

    def points(self, points: Mapping[int, StripePoints], stamp: int) -> None:
        """Send the points of a scan's stripes, by index."""
        kept = dict(points)
        self._server.mirror(lambda: self._named(self._scene.of_points(kept, stamp)), lane="points")

    def _of_grid(self, message: TerrainMessage) -> Iterator[Named]:
        return self._named(self._scene.of_grid(message, unknown=self._unknown))

    def _named(self, messages: Iterable[Named]) -> Iterator[Named]:
        """Messages to send, with topics below `/<robot>/`."""
        for name, message in messages:
            if self._with_tf or name not in OF_THE_ROBOT:
                yield name.removeprefix("/"), message
