"""Client for planners: receives grids and requests scans."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TypedDict, Unpack

from guara_perception.app.map_summary import MapRegions, TerrainSummary, message_to_regions, message_to_summary
from guara_perception.app.messages import message_to_terrain
from guara_perception.exceptions import PerceptionError
from guara_perception.terrain.grid import TerrainGrid
from transport import DEFAULT_ROBOT, ScanReply, Status, TerrainMessage, open_client
from transport.client import PerceptionClient
from transport.grids.grid_judge import Accepted
from transport.grids.node_clock import ClockOffset
from transport.keys import check_encoding, check_name

logger = logging.getLogger(__name__)


class AcceptedState(TypedDict, total=False):
    """Keyword arguments that select grids by their state, as in `TerrainClient.latest`."""

    allow_stale: bool
    confirmed_only: bool


class TerrainClient(AbstractContextManager["TerrainClient"]):
    """Receiver of the newest terrain of one robot; use it in a `with` block.

    Example:
        with TerrainClient("tcp/127.0.0.1:7447", robot="guara") as client:
            for terrain in client.stream():
                print(terrain.best_foothold(0.72, 0.18, radius=0.05))
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
            endpoint: endpoint of the node or the router; None = tcp/127.0.0.1:7447, or that of the security folder.
            robot: instance name of the robot.
            security: folder of a role made by `guara security init`, for a node with security.
            timeout: seconds to wait for the connection.
            encoding: "lossless", or "compact" for slow links: an eighth of the size, heights to 0.06 mm, all else
                rounded conservatively, so that nothing is accepted that the lossless grid rejects.

        Raises:
            transport.KeyNameError: unknown encoding.
            transport.ConnectionFailed: no answer; the message lists what to check.
        """
        check_name(robot)
        check_encoding(encoding)
        session = open_client(endpoint, security=security, timeout=timeout)
        # Each extent is subscribed to on first use: a map is large, and not every client needs it.
        self._client = PerceptionClient(session, robot=robot, encoding=encoding)

    def __exit__(self, *error: object) -> None:
        self.close()

    @property
    def is_alive(self) -> bool:
        """True while the node's liveliness token is present."""
        return self._client.is_alive

    def status(self) -> Status | None:
        """The node's newest status, None before the first; an item `node` reports a node that has been silent."""
        return self._client.status()

    def counts(self, extent: str = "footprint") -> dict[str, int]:
        """Numbers of grids received, superseded before use, lost in transfer, and rejected.

        A grid is rejected if it is damaged, of another robot, frame or node, or older than the one before.
        """
        receiver = self._client.receiver(extent)
        counts = {name: getattr(receiver, name) for name in ("received", "superseded", "missed")}
        return {**counts, "rejected": receiver.rejected + receiver.refused}

    @property
    def clock_offset(self) -> ClockOffset | None:
        """Offset of the node's wall clock from this machine's, None before it is known; ages do not depend on it."""
        return self._client.clock_offset

    def latest(
        self,
        max_age: float | None = None,
        extent: str = "footprint",
        allow_stale: bool = False,
        *,
        confirmed_only: bool = False,
    ) -> TerrainGrid:
        """The newest grid, if it may be used.

        A footprint may be used from its scan until the next pause begins or the gait announces movement, while its node
        is alive. A map may be used for as many pauses as its record states.

        Args:
            max_age: largest age since the end of the scan [s]; None = the grid's own validity. Relaxes no other rule.
            extent: "footprint" (last scan) or "map" (fused).
            allow_stale: return a stale grid too: of another pause or walk, withdrawn, too old, or of a node that is no
                longer alive. `stale_because` of the grid gives the reasons, and its queries require `allow_stale` too.
            confirmed_only: reject a provisional grid.

        Raises:
            StaleTerrain: the newest grid may not be used, or there is none yet.
            ScannerUnavailable: no grid and no node.
            UnsafeGrid: the grid breaks the safety invariant and must not be used.
        """
        return message_to_terrain(
            self._client.latest(extent=extent, max_age=max_age, allow_stale=allow_stale, confirmed_only=confirmed_only)
        )

    def summary(
        self, timeout: float = 30.0, max_age: float | None = None, **accepted: Unpack[AcceptedState]
    ) -> TerrainSummary:
        """Newest summary of the fused map: a few kilobytes, for slow links.

        A router may drop summaries, since none depends on an earlier one. The first call waits for a summary; a later
        one waits only if the newest may not be used.

        Args:
            timeout: seconds to wait for one that may be used.
            max_age: as in `latest`.
            accepted: allow_stale, confirmed_only as in `latest`.

        Raises:
            StaleTerrain: the newest summary may not be used, and no newer one came in time.
            transport.ReceiveTimeout: none came in time although the node is alive.
            ScannerGone, ScannerUnavailable: none came, and the node went away or was never there.
            UnsafeGrid: the summary breaks the safety invariant and must not be used.
        """
        return message_to_summary(self._client.summary(timeout=timeout, max_age=max_age, **accepted))

    def regions(
        self, timeout: float = 30.0, max_age: float | None = None, **accepted: Unpack[AcceptedState]
    ) -> MapRegions:
        """Convex steppable regions of the newest fused map, largest first, without the map itself.

        Arguments and errors are those of `summary`; a client that connects later gets the last message at once.
        """
        return message_to_regions(self._client.regions(timeout=timeout, max_age=max_age, **accepted))

    def stream(
        self, timeout: float | None = None, extent: str = "footprint", **accepted: Unpack[Accepted]
    ) -> Iterator[TerrainGrid]:
        """Yield the newest grid that may be used, then each newer one as it comes; stale ones are skipped.

        A pause gives up to three grids: coarse, refined, and confirmed once the gait has announced that the robot stood
        still. A grid that withdraws earlier ones is yielded too: nothing is known in it, and `stale_because` gives the
        reason.

        Args:
            timeout: seconds to wait for each grid; None = no limit (Ctrl-C works).
            extent: "footprint" or "map".
            accepted: max_age, allow_stale, confirmed_only as in `latest`.

        Raises:
            transport.ReceiveTimeout: no grid in time.
            ScannerGone, ScannerUnavailable: none came, and the node went away or was never there.
        """
        number = 0
        while True:
            received = self._client.receive(
                lambda _: True,
                timeout=timeout,
                extent=extent,
                after=number,
                takes_back=True,
                **accepted,
            )
            number = received.number
            yield message_to_terrain(received.message)

    def on_terrain(
        self, callback: Callable[[TerrainGrid], None], extent: str = "footprint", **accepted: Unpack[Accepted]
    ) -> None:
        """Call `callback` with the newest grid when one arrives, on the client's own thread; older ones are skipped.

        The grids and arguments are those of `stream`. A grid that may not be used or breaks the safety invariant is
        logged and not passed on.
        """

        def hand_over(message: TerrainMessage) -> None:
            try:
                terrain = message_to_terrain(message)
            except PerceptionError as error:
                logger.error("%s", error)
                return
            callback(terrain)

        self._client.on_terrain(hand_over, extent=extent, **accepted)

    def wait_for_step(
        self,
        step: int,
        timeout: float = 30.0,
        extent: str = "footprint",
        *,
        epoch: str | None = None,
        confirmed: bool = False,
        refined_only: bool = False,
        **accepted: Unpack[Accepted],
    ) -> TerrainGrid:
        """Wait for the newest grid of stance pause `step`, or of a later one of the same walk.

        Args:
            step: number of the pause.
            timeout: seconds to wait.
            extent: "footprint" or "map".
            epoch: identity of the walk as the gait announces it; None = the current walk of the node. Give it if
                the gait restarts its count: until the first BEGIN, the node is still in the previous walk.
            confirmed: the same as `confirmed_only`.
            refined_only: skip a coarse grid that is refined in the same pause; a confirmed grid is never coarse.
            accepted: max_age, allow_stale as in `latest`; confirmed_only to wait until the gait has confirmed that the
                robot stood still through the scan. Until then a grid is provisional (`TerrainGrid.is_provisional`):
                usable while the robot stands, and may be withdrawn.

        Raises:
            transport.ReceiveTimeout: none came in time although the node is alive.
            ScannerGone, ScannerUnavailable: none came, and the node went away or was never there.
        """
        if confirmed:
            accepted["confirmed_only"] = True
        return message_to_terrain(
            self._client.wait_for_step(
                step, timeout=timeout, extent=extent, epoch=epoch, refined_only=refined_only, **accepted
            )
        )

    def request_scan(
        self,
        mode: str = "standard",
        timeout: float = 30.0,
        *,
        on_progress: Callable[[ScanReply], None] | None = None,
        **accepted: Unpack[AcceptedState],
    ) -> TerrainGrid:
        """Request a scan and return its grid.

        Args:
            mode: "coarse" or "standard".
            timeout: seconds to wait for the grid.
            on_progress: called with every progress report.
            accepted: allow_stale as in `latest`; confirmed_only to wait until the gait has confirmed the grid, which is
                provisional until then.

        Raises:
            ScanBusy: a scan is under way.
            ScanFailed: the node refused the scan or could not finish it.
            ScanTimeout: the scan was not finished in time.
            ScannerGone: the node went away meanwhile.
            ScannerUnavailable: there is no node, or this client may not request scans.
        """
        return message_to_terrain(
            self._client.request_scan(mode=mode, timeout=timeout, on_progress=on_progress, **accepted)
        )

    def query(
        self,
        region: tuple[float, float, float, float] | None = None,
        timeout: float = 5.0,
        extent: str = "footprint",
        **accepted: Unpack[Accepted],
    ) -> TerrainGrid:
        """Fetch the node's newest grid once, or a region (x_min, x_max, y_min, y_max) [m] of it.

        `accepted`: max_age, allow_stale and confirmed_only as in `latest`.

        Raises:
            StaleTerrain: the newest grid may not be used, or there is none yet.
            ScannerUnavailable: no node answers.
        """
        return message_to_terrain(self._client.query(extent=extent, region=region, timeout=timeout, **accepted))

    def close(self) -> None:
        """Disconnect; safe to call twice."""
        self._client.close()
