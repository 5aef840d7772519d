"""`TerrainClient`: what a planner uses to get grids and to ask for scans."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from pathlib import Path
from types import TracebackType
from typing import Self

from guara_perception.app.map_regions import MapRegions, message_to_regions
from guara_perception.app.map_summary import TerrainSummary, message_to_summary
from guara_perception.app.messages import message_to_terrain
from guara_perception.exceptions import PerceptionError
from guara_perception.terrain.grid import TerrainGrid
from transport import DEFAULT_ROBOT, ScanReply, Status, TerrainMessage, open_client
from transport.client import PerceptionClient
from transport.keys import check_encoding, check_name
from transport.node_clock import ClockOffset

logger = logging.getLogger(__name__)


class TerrainClient:
    """Receives the newest terrain of one robot; use it in a `with` block.

    Example:
        with TerrainClient("tcp/127.0.0.1:7447", robot="guara") as client:
            terrain = client.latest(max_age=60.0)
    """

    def __init__(
        self,
        endpoint: str | None = None,
        *,
        robot: str = DEFAULT_ROBOT,
        security: str | Path | None = None,
        timeout: float = 5.0,
        encoding: str = "lossless",
    ) -> None:
        """Connect.

        Args:
            endpoint: where the node (or the router) listens; None = tcp/127.0.0.1:7447, or what the security folder
                says.
            robot: instance name of the robot.
            security: folder of a role made by `guara security init`, for a node with security.
            timeout: seconds to wait for the connection.
            encoding: "lossless", or "compact" for slow links: an eighth of the size, heights to 0.06 mm, all else
                rounded to the safe side, so that nothing is accepted which the lossless grid refuses.

        Raises:
            transport.KeyNameError: unknown encoding.
            transport.ConnectionFailed: nobody answers; the message lists what to check.
        """
        check_name(robot)
        check_encoding(encoding)
        session = open_client(endpoint, security=security, timeout=timeout)
        # Each extent is subscribed to when first asked for: a map is large, and not everybody needs it.
        self._client = PerceptionClient(session, robot=robot, encoding=encoding)

    def __enter__(self) -> Self:
        """The client itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close."""
        self.close()

    @property
    def is_alive(self) -> bool:
        """Whether the node shows its sign of life."""
        return self._client.is_alive

    def status(self) -> Status | None:
        """The node's newest status, or None when none came yet."""
        return self._client.status()

    def counts(self, extent: str = "footprint") -> dict[str, int]:
        """Grids received, superseded before anybody asked, missed on the way, and rejected.

        Rejected are damaged grids, those of another robot, frame or node, and those older than the one before.
        """
        receiver = self._client.receiver(extent)
        counts = {name: getattr(receiver, name) for name in ("received", "superseded", "missed")}
        return {**counts, "rejected": receiver.rejected + receiver.refused}

    @property
    def clock_offset(self) -> ClockOffset | None:
        """How the node's wall clock stands against this machine's; ages do not depend on it. None: not known yet."""
        return self._client.clock_offset

    def latest(self, max_age: float | None = None, extent: str = "footprint") -> TerrainGrid:
        """The newest grid, if it may still be used.

        Args:
            max_age: seconds since the end of its scan; None = the grid's own validity, in time and pauses.
            extent: "footprint" (last scan) or "map" (fused).

        Raises:
            StaleTerrain: the newest grid is too old, or there is none yet.
            ScannerUnavailable: no grid and no node.
            UnsafeGrid: the grid breaks the safety invariant and must not be used.
        """
        return message_to_terrain(self._client.latest(extent=extent, max_age=max_age))

    def summary(self, timeout: float = 30.0, max_age: float | None = None) -> TerrainSummary:
        """The newest summary of the fused map: a few kilobytes, for the far end of a thin link.

        It has no history, so that a router on the way may thin it out: the first call waits for one, a later one only
        when the newest is too old.

        Args:
            timeout: seconds to wait for one that is not too old.
            max_age: seconds since the end of its scan; None = its own validity, in time and pauses.

        Raises:
            StaleTerrain: the newest summary is too old, and no newer one came in time.
            transport.ReceiveTimeout: none came in time although the node lives.
            ScannerGone, ScannerUnavailable: none came, and the node went away or was never there.
            UnsafeGrid: it breaks the safety invariant and must not be used.
        """
        return message_to_summary(self._client.summary(timeout=timeout, max_age=max_age))

    def regions(self, timeout: float = 30.0, max_age: float | None = None) -> MapRegions:
        """The convex steppable regions of the newest fused map, without the map itself.

        Arguments and errors are those of `summary`; a client that connects later gets the last message at once.
        """
        return message_to_regions(self._client.regions(timeout=timeout, max_age=max_age))

    def stream(
        self, timeout: float | None = None, extent: str = "footprint", *, max_age: float | None = None
    ) -> Iterator[TerrainGrid]:
        """Yield the newest grid, then each newer one as it comes; older ones, and those too old, are skipped.

        Args:
            timeout: seconds to wait for each grid; None waits without end (Ctrl-C works).
            extent: "footprint" or "map".
            max_age: as in `latest`; infinite takes grids of any age.

        Raises:
            transport.ReceiveTimeout: no grid in time.
            ScannerGone, ScannerUnavailable: none came, and the node went away or was never there.
        """
        number = 0
        while True:
            received = self._client.receive(
                lambda _: True, timeout=timeout, extent=extent, max_age=max_age, after=number
            )
            number = received.number
            yield message_to_terrain(received.message)

    def on_terrain(
        self, callback: Callable[[TerrainGrid], None], extent: str = "footprint", *, max_age: float | None = None
    ) -> None:
        """Call `callback` with the newest grid whenever one comes, on the client's own thread; older ones are skipped.

        A grid that is too old (`max_age` as in `latest`) or breaks the safety invariant is logged and not handed over.
        """

        def hand_over(message: TerrainMessage) -> None:
            try:
                terrain = message_to_terrain(message)
            except PerceptionError as error:
                logger.error("%s", error)
                return
            callback(terrain)

        self._client.on_terrain(hand_over, extent=extent, max_age=max_age)

    def wait_for_step(
        self,
        step: int,
        timeout: float = 30.0,
        extent: str = "footprint",
        *,
        epoch: str | None = None,
        confirmed: bool = False,
        max_age: float | None = None,
    ) -> TerrainGrid:
        """Wait for the grid of stance pause `step`, or of a later one of the same walk.

        Args:
            step: number of the pause.
            timeout: seconds to wait.
            extent: "footprint" or "map".
            epoch: identity of the walk as the gait announces it; None takes the walk that the node is on. A gait that
                starts counting again should give it: before its first BEGIN is heard, the node is on the walk before.
            confirmed: wait until the gait has said that the robot stood still through the scan; before, a grid is
                provisional (`TerrainGrid.is_provisional`): it may be used while the robot stands, and may be withdrawn.
            max_age: as in `latest`; infinite takes grids of any age.

        Raises:
            transport.ReceiveTimeout: none came in time although the node lives.
            ScannerGone, ScannerUnavailable: none came, and the node went away or was never there.
        """
        return message_to_terrain(
            self._client.wait_for_step(
                step, timeout=timeout, extent=extent, epoch=epoch, confirmed=confirmed, max_age=max_age
            )
        )

    def request_scan(
        self,
        mode: str = "standard",
        timeout: float = 30.0,
        *,
        on_progress: Callable[[ScanReply], None] | None = None,
    ) -> TerrainGrid:
        """Ask for a scan now and return its grid.

        Args:
            mode: "coarse" or "standard".
            timeout: seconds until the grid must be there.
            on_progress: called with every reply on the way.

        Raises:
            ScanBusy: a scan is under way.
            ScanFailed: the node refused or could not finish.
            ScanTimeout: it was not finished in time.
            ScannerGone: the node went away meanwhile.
            ScannerUnavailable: no node, or this side may not ask.
        """
        return message_to_terrain(self._client.request_scan(mode=mode, timeout=timeout, on_progress=on_progress))

    def query(
        self,
        region: tuple[float, float, float, float] | None = None,
        timeout: float = 5.0,
        extent: str = "footprint",
        *,
        max_age: float | None = None,
    ) -> TerrainGrid:
        """The node's newest grid, or a region (x_min, x_max, y_min, y_max) [m] of it, asked for once.

        Raises:
            ScannerUnavailable: nobody answers.
        """
        return message_to_terrain(self._client.query(extent=extent, region=region, timeout=timeout, max_age=max_age))

    def close(self) -> None:
        """Disconnect; safe to call twice."""
        self._client.close()
