"""Live data for the viewer: messages of a running node, combined by pause as they arrive."""

from __future__ import annotations

import logging
import math
import threading
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from guara_perception.app.messages import message_to_terrain
from guara_perception.app.scene.scene import cloud_points, planned_footholds
from guara_perception.exceptions import PerceptionError
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.layers.layered_grid import EXTENTS
from guara_perception.view.moment import Moment
from kinematics import KinematicsError
from transport import TerrainMessage, TransportError, open_client
from transport.client import PerceptionClient
from transport.exceptions import SessionClosed
from transport.fleet import living_robots
from transport.keys import check_name, picture_key, points_key
from transport.links.receiver import NewestReceiver
from transport.messages.codec import decode, read_time
from transport.messages.typestore import COMPRESSED_IMAGE, POINT_CLOUD
from transport.supervision import Seldom

if TYPE_CHECKING:
    from kinematics import RobotModel
    from transport.links.received import Received

logger = logging.getLogger(__name__)
# [s] Longest wait for the router's list of the running robots.
ROUTER_TIMEOUT_S = 2.0


class LiveMoments(AbstractContextManager["LiveMoments"]):
    """Receiver of grids, points and camera images of one robot. It shows each pause with the data received so far.

    Messages with equal stamps belong together. After the first map, a scan is shown only once its map has arrived or it
    is withdrawn.
    """

    def __init__(
        self,
        show: Callable[[Moment], None],
        model: RobotModel,
        endpoint: str | None,
        *,
        robot: str,
        security: str | Path | None = None,
    ) -> None:
        """Connect to the node's router.

        Args:
            show: called on a client thread with each moment, and again whenever further data of the same pause arrive.
            model: kinematic model of the robot.
            endpoint, robot, security: as in `TerrainClient`.

        Raises:
            transport.KeyNameError: invalid robot name.
            transport.ConfigurationError, transport.SecurityError: the endpoint or the security folder is not valid.
            transport.ConnectionFailed: no answer; the message lists what to check.
        """
        check_name(robot)
        self._show, self._model = show, model
        self._lock = threading.Lock()
        self._refusals = Seldom(logger)
        self._grids: dict[str, TerrainGrid] = {}
        # Newest stripes and picture, as in `Moment`, with the stamp of their scan [ns].
        self._parts: dict[str, tuple[int, Callable[[], Any]]] = {}
        self._robot, self._has_shown = robot, False
        self._session = session = open_client(endpoint, security=security)
        self._client = PerceptionClient(session, robot=robot)
        for extent in EXTENTS:
            self._client.on_terrain(self._take_grid, extent=extent)
        points = NewestReceiver(session, points_key(robot), lambda payload: decode(payload, POINT_CLOUD))
        points.on_newest(self._take_points)
        pictures = NewestReceiver(session, picture_key(robot), lambda payload: decode(payload, COMPRESSED_IMAGE))
        pictures.on_newest(self._take_picture)

    def __exit__(self, *error: object) -> None:
        self._client.close()

    def missing(self) -> str:
        """Explain why nothing has been shown yet; if the node is not found, list the robots on its router.

        The text is empty after the first moment, or if the session is closed. Querying the router takes up to
        `ROUTER_TIMEOUT_S`.
        """
        if self._has_shown:
            return ""
        try:
            robots = living_robots(self._session, timeout=ROUTER_TIMEOUT_S)
        except SessionClosed:
            return ""
        if self._robot in robots or self._client.is_alive:
            return f"waiting for the first grid of {self._robot!r}: its node is running but has sent no usable grid yet"
        others = f"running here: {', '.join(robots)} (select one with --name)" if robots else "no robot is visible here"
        return f"waiting for a robot with instance name {self._robot!r}: no such node on this router; {others}"

    def state(self) -> tuple[str, bool]:
        """Status line of the newest map, or of the newest scan before the first map, and True if it is stale.

        The line has step, age and the reasons why the grid is stale. Returns ("", False) before the first grid, and the
        text of an error with True if the grid cannot be received.
        """
        extent = "map" if "map" in self._grids else "footprint"
        try:
            received = self._client.receiver(extent).latest()
            grid = None if received is None else self._client.latest(extent=extent, max_age=math.inf, allow_stale=True)
        except TransportError as error:
            return str(error), True
        if received is None or grid is None:
            return "", False
        text = f"{extent} of step {grid.step}, {self._client.age(received):.0f} s old"
        return "; ".join((text, *grid.stale_because)), bool(grid.stale_because)

    def _take_grid(self, message: TerrainMessage) -> None:
        try:
            terrain = message_to_terrain(message)
        except PerceptionError as error:
            logger.error("%s", error)
            return
        with self._lock:
            is_first_map = "map" not in self._grids
            self._grids[terrain.extent] = terrain
            # Do not show a scan before its map, which contains its pose in odom. A withdrawn scan may have no map.
            if terrain.extent == "map" or is_first_map or terrain.record.withdrawn:
                self._show_scan(terrain)

    def _take_points(self, received: Received[Any]) -> None:
        points = [cloud_points(received.message)]
        self._take_part("stripes", received.message, lambda: points)

    def _take_picture(self, received: Received[Any]) -> None:
        message = received.message
        image = cv2.imdecode(np.asarray(message.data, dtype=np.uint8), cv2.IMREAD_COLOR)
        if image is None:
            logger.warning("skipping camera image: cannot decode it (declared format %r)", message.format)
            return
        self._take_part("picture", message, lambda: image)

    def _take_part(self, name: str, message: Any, part: Callable[[], Any]) -> None:
        """Keep a part of a moment, and show the current moment again if the part belongs to its scan."""
        with self._lock:
            stamp = read_time(message.header.stamp)
            self._parts[name] = stamp, part
            terrain = self._grids.get("map") or self._grids.get("footprint")
            if terrain is not None and terrain.stamp == stamp:
                self._show_scan(terrain)

    def _show_scan(self, terrain: TerrainGrid) -> None:
        """Show the scan of a grid with all messages of its stamp."""
        grids = {name: self._grids[name] for name in EXTENTS if name in self._grids}
        grids = {name: grid for name, grid in grids.items() if grid.stamp == terrain.stamp}
        parts = {name: part for name, (stamp, part) in self._parts.items() if stamp == terrain.stamp}
        try:
            planned = {} if terrain.record.withdrawn else planned_footholds(self._model, terrain)
            self._show(Moment(grids, footholds=planned, **parts))
            self._has_shown = True
        except (KinematicsError, PerceptionError) as error:
            self._refusals.log("cannot show a grid that does not match robot %r (--robot): %s", self._model.name, error)
