"""Live scene of each pause for ROS 2: the topics that recordings contain for viewers, sent by the server's bridge."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING

from guara_perception.app.scene.scene import Named, Scene
from kinematics import Stance
from transport import TerrainMessage
from transport.server import PerceptionServer

if TYPE_CHECKING:
    from guara_perception.ranging.stripe_points import StripePoints

# Topics that a robot usually publishes itself; they are sent only on request.
OF_THE_ROBOT = ("/tf", "/tf_static", "/robot_description")


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
