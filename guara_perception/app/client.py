"""Planner's client of the perception node: receives grids and requests scans."""

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
    """Client that receives the newest terrain of one robot; use it in a `with` block.

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
        """Connect to a node or router.

        Args:
            endpoint: endpoint of the node or the router; None = that of the security folder, or tcp/127.0.0.1:7447.
            robot: instance name of the robot.
            security: folder of a role made by `guara security init`, for a node with security.
            timeout: seconds to wait for the connection.
            encoding: "lossless", or "compact" for slow links: about an eighth of the size, heights accurate to 0.06 mm,
                everything else rounded conservatively, so that nothing is accepted that the lossless grid rejects.

        Raises:
            transport.KeyNameError: invalid robot name or unknown encoding.
            transport.ConfigurationError: the endpoint is not valid, missing in the security folder, or not encrypted
                although `security` is given.
            transport.SecurityError: the security folder is incomplete or unreadable, or others can read its private
                key.
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
        """True while the node is running, according to its liveliness token."""
        return self._client.is_alive

    def status(self) -> Status | None:
        """Return the newest status of the node; None before the first. An item `node` reports a silent node.

        Raises:
            transport.MessageError: the newest status is damaged.
        """
        return self._client.status()

    def counts(self, extent: str = "footprint") -> dict[str, int]:
        """Return the numbers of grids received, superseded before use, lost in transit ("missed"), and rejected.

        A grid is rejected if it is damaged, belongs to another robot, extent, frame or run of the node, or is not newer
        than the last one.

        Raises:
            transport.MessageError: unknown extent.
        """
        receiver = self._client.receiver(extent)
        counts = {name: getattr(receiver, name) for name in ("received", "superseded", "missed")}
        return {**counts, "rejected": receiver.rejected + receiver.refused}

    @property
    def clock_offset(self) -> ClockOffset | None:
        """Offset of the node's wall clock from this machine's; None before it is known."""
        return self._client.clock_offset

    def latest(
        self,
        max_age: float | None = None,
        extent: str = "footprint",
        allow_stale: bool = False,
        *,
        confirmed_only: bool = False,
    ) -> TerrainGrid:
        """Return the newest grid if it may be used.

        A footprint may be used until the next pause begins, a provisional one only until its own pause ends. A map may
        be used for as many pauses as its record states. Either may be used only while its node confirms it.

        Args:
            max_age: largest age since the end of the scan [s]; None = the grid's own validity. All other rules still
                apply.
            extent: "footprint" (last scan) or "map" (fused).
            allow_stale: also return a stale grid: one of another pause or walk, withdrawn, too old, or no longer
                confirmed by its node. The reasons are in `stale_because` of the grid, whose queries then also require
                `allow_stale`.
            confirmed_only: reject a provisional grid.

        Raises:
            StaleTerrain: the newest grid may not be used, or there is no grid yet.
            ScannerUnavailable: there is neither a grid nor a node.
            UnsafeGrid: the grid violates the safety invariant and must not be used.
            transport.MessageError: unknown extent, or the newest sample is damaged.
        """
        return message_to_terrain(
            self._client.latest(extent=extent, max_age=max_age, allow_stale=allow_stale, confirmed_only=confirmed_only)
        )

    def summary(
        self, timeout: float = 30.0, max_age: float | None = None, **accepted: Unpack[AcceptedState]
    ) -> TerrainSummary:
        """Return the newest summary of the fused map: a few kilobytes, for slow links.

        A lost summary does no harm, because none depends on an earlier one. The first call waits for a summary; a
        later call waits only if the newest summary may not be used.

        Args:
            timeout: seconds to wait for a summary that may be used.
            max_age: as in `latest`.
            accepted: allow_stale, confirmed_only as in `latest`.

        Raises:
            StaleTerrain: the newest summary may not be used, and no newer one arrived in time.
            transport.ReceiveTimeout: no summary arrived in time although the node is alive.
            ScannerGone, ScannerUnavailable: no summary arrived, and the node went away or was never there.
            UnsafeGrid: the summary violates the safety invariant and must not be used.
        """
        return message_to_summary(self._client.summary(timeout=timeout, max_age=max_age, **accepted))

    def regions(
        self, timeout: float = 30.0, max_age: float | None = None, **accepted: Unpack[AcceptedState]
    ) -> MapRegions:
        """Return the convex steppable regions of the newest fused map, largest first, without the map itself.

        Arguments and errors are those of `summary`. The last message sent before the first call is received too.
        """
        return message_to_regions(self._client.regions(timeout=timeout, max_age=max_age, **accepted))

    def stream(
        self, timeout: float | None = None, extent: str = "footprint", **accepted: Unpack[Accepted]
    ) -> Iterator[TerrainGrid]:
        """Yield the newest grid that may be used, then newer grids as they arrive; stale grids are skipped.

        A pause has up to three grids: a coarse grid, a refined grid, and a confirmed grid once the gait has announced
        that the robot stood still. A grid that withdraws earlier grids is also yielded: no cell of it is known, and
        `stale_because` gives the reason.

        Args:
            timeout: seconds to wait for each grid; None = no limit (Ctrl-C works).
            extent: "footprint" or "map".
            accepted: max_age, allow_stale, confirmed_only as in `latest`.

        Raises:
            transport.ReceiveTimeout: no usable grid arrived in time although the node is alive.
            ScannerGone, ScannerUnavailable: no usable grid arrived, and the node went away or was never there.
            UnsafeGrid: a grid violates the safety invariant and must not be used.
            transport.MessageError: unknown extent.
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
        """Call `callback` with each new grid, on the client's own thread; grids superseded during a call are skipped.

        Grids and arguments are as in `stream`. A grid that violates the safety invariant is logged and not passed on.

        Raises:
            transport.MessageError: unknown extent.
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
        """Wait for the newest grid of stance pause `step` or of a later pause of the same walk.

        Args:
            step: number of the pause.
            timeout: seconds to wait.
            extent: "footprint" or "map".
            epoch: identity of the walk as announced by the gait; None = the current walk of the node. Required if the
                gait restarts its step count: until the first BEGIN, the node is still in the previous walk.
            confirmed: the same as `confirmed_only`.
            refined_only: skip a coarse grid that is refined later in the same pause.
            accepted: max_age, allow_stale as in `latest`; confirmed_only to wait until the gait has confirmed that the
                robot stood still throughout the scan. Until then a grid is provisional (`TerrainGrid.is_provisional`):
                it is usable while the robot stands, and may be withdrawn.

        Raises:
            transport.ReceiveTimeout: no such grid arrived in time although the node is alive.
            ScannerGone, ScannerUnavailable: no such grid arrived, and the node went away or was never there.
            UnsafeGrid: the grid violates the safety invariant and must not be used.
            transport.MessageError: unknown extent.
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
        """Request a scan and return its grid, or a later one.

        Args:
            mode: "coarse" or "standard".
            timeout: seconds to wait for the grid.
            on_progress: called with every progress report.
            accepted: allow_stale as in `latest`; confirmed_only to wait until the gait has confirmed the grid, which is
                provisional until then.

        Raises:
            ScanBusy: a scan is already under way.
            ScanFailed: the node refused the scan or could not finish it.
            ScanTimeout: the scan was not finished in time.
            transport.ReceiveTimeout: the scan was finished, but no usable grid arrived in time.
            ScannerGone: the node went away.
            ScannerUnavailable: there is no node, or this client may not request scans.
            transport.MessageError: an argument is not allowed, or a reply is damaged.
            UnsafeGrid: the grid violates the safety invariant and must not be used.
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

        `accepted` may contain max_age, allow_stale and confirmed_only, as in `latest`.

        Raises:
            StaleTerrain: the newest grid may not be used, or there is no grid yet.
            ScannerUnavailable: there is no node, or this client may not query it.
            UnsafeGrid: the grid violates the safety invariant and must not be used.
            transport.ReceiveTimeout: no reply arrived in time.
            transport.MessageError: extent or region is not valid, or the reply is damaged or not from this node.
        """
        return message_to_terrain(self._client.query(extent=extent, region=region, timeout=timeout, **accepted))

    def close(self) -> None:
        """Disconnect; may be called twice. Later calls that need the connection raise `transport.SessionClosed`."""
        self._client.close()
