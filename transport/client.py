"""Client side of the transport, for planners and viewers: newest grids, scan requests, queries, liveliness."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, suppress
from functools import partial
from numbers import Integral
from typing import Any, Unpack

from transport import clock
from transport.exceptions import MessageError, ReceiveTimeout, StaleTerrain, check_choice
from transport.grids.evidence import G
from transport.grids.grid_judge import SETTLE, TAKING_BACK, Accepted, GridJudge, Terms
from transport.grids.node_clock import ClockOffset
from transport.keys import DEFAULT_ROBOT, check_encoding, query_key, regions_key, summary_key, terrain_key
from transport.links.received import Received
from transport.links.receiver import NewestReceiver
from transport.links.session import Session
from transport.messages.map_messages import RegionsMessage, SummaryMessage, decode_regions, decode_summary
from transport.messages.scan_messages import ScanReply
from transport.messages.status_message import Status
from transport.messages.terrain_message import EXTENTS, TerrainMessage, decode_terrain
from transport.queries.query import query_terrain
from transport.queries.scan_client import ARRIVES_WITHIN, request_scan, result_of
from transport.supervision import Seldom

# Longest time in which a running node delivers its last grid, even over a slow link or from a busy machine [s].
FIRST_GRID = 5.0
# Longest wait for the next BEGIN [s] after a grid of a later pause than requested. Such a grid may be from a walk that
# has ended; while the robot moves, only the next BEGIN can show this.
NEWS = 1.0

# Predicate that accepts any message.
ANY: Callable[[object], bool] = lambda _: True  # noqa: E731

logger = logging.getLogger(__name__)


class PerceptionClient(AbstractContextManager["PerceptionClient"]):
    """Client of one robot: receives its grids and requests scans.

    Each kind of grid is subscribed to at its first use. `GridJudge` accepts or rejects each grid by sender, order and
    age.

    Attributes:
        robot: instance name.
    """

    def __init__(self, session: Session, *, robot: str = DEFAULT_ROBOT, encoding: str = "lossless") -> None:
        """Start to monitor liveliness and status of the node.

        Args:
            session: open session; closing the client closes it.
            robot: instance name.
            encoding: encoding of the grids: "lossless" or "compact" (`transport.messages.terrain_message`).

        Raises:
            KeyNameError: the encoding is unknown, or the robot name cannot be part of a key.
            SessionClosed: the session is closed.
        """
        self.robot = robot
        self._encoding = check_encoding(encoding)
        self._session = session
        self._receivers: dict[str, NewestReceiver[Any]] = {}
        self._since: dict[str, float] = {}
        self._judge = GridJudge(session, robot)

    def __exit__(self, *error: object) -> None:
        """Close the client."""
        self.close()

    def receiver(self, extent: str = "footprint") -> NewestReceiver[TerrainMessage]:
        """Return the receiver of an extent, with counts of messages received, superseded, missed and rejected.

        Raises:
            MessageError: the extent is unknown.
            SessionClosed: the client is closed, and this is the first call for this extent.
        """
        check_choice("extent", extent, EXTENTS)
        return self._receiver(extent, terrain_key(self.robot, extent, self._encoding), decode_terrain)

    @property
    def is_alive(self) -> bool:
        """True while the liveliness token of the node exists."""
        return self._judge.node.is_alive

    def wait_until_alive(self, timeout: float) -> bool:
        """Wait until the node is alive. Return False if it is not alive after `timeout` [s]."""
        return self._judge.node.wait(True, timeout)

    def status(self) -> Status | None:
        """Return the newest status of the node, or None before the first.

        Raises:
            MessageError: the newest status is damaged.
        """
        return self._judge.status()

    @property
    def clock_offset(self) -> ClockOffset | None:
        """Offset between the wall clocks of node and client; None until the node has reported its clock."""
        return self._judge.clock.offset

    def age(self, received: Received[TerrainMessage]) -> float:
        """Return an upper bound of the time since the end of the scan of a received grid [s]; see `GridJudge.age`."""
        return self._judge.age(received)

    def latest(self, *, extent: str = "footprint", **accepted: Unpack[Accepted]) -> TerrainMessage:
        """Return the newest grid, if it may be used.

        Args:
            extent: "footprint" or "map".
            accepted: fields of `Terms`. `max_age` changes the age limit only. With `allow_stale`, stale grids are
                returned too, with the reasons in `stale_because`.

        Raises:
            StaleTerrain: the newest grid may not be used, or the node has not published one yet.
            ScannerUnavailable: there is no grid and no node.
            SessionClosed: the client is closed, so it would not notice that the grid is no longer valid.
            MessageError: the newest sample is not a valid grid, or the extent is unknown.
        """
        receiver = self.receiver(extent)
        self._session.check_open()
        received = receiver.latest() or self._first(extent, SETTLE)
        if received is None and self.is_alive:
            received = self._first(extent, FIRST_GRID)
        if received is None:
            if self.is_alive:
                older = "" if self._encoding == "lossless" else "; earlier versions do not support encoding 'compact'"
                raise StaleTerrain(
                    f"the node of {self.robot!r} is running but has not published a {extent} grid yet{older}"
                )
            raise self._judge.unavailable()
        deadline = time.monotonic() + SETTLE
        while True:
            try:
                left, is_superseded = deadline - time.monotonic(), partial(receiver.has_newer, received)
                return self._judge.check(received, Terms(**accepted), patience=left, is_superseded=is_superseded)
            except StaleTerrain:
                newer = receiver.latest()
                if newer is None or newer.number == received.number:
                    raise
                received = newer

    def summary(self, *, timeout: float, **accepted: Unpack[Accepted]) -> SummaryMessage:
        """Return the newest usable summary of the map; wait for one if necessary.

        A summary sent before the first call is never received. Invalid samples are skipped.

        Args:
            timeout: longest wait [s].
            accepted: as in `latest`.

        Raises:
            StaleTerrain: the newest summary may not be used, and no newer one arrived in time.
            ReceiveTimeout: no summary arrived in time although the node is alive.
            ScannerGone: no summary arrived, and the node has disappeared.
            ScannerUnavailable: no summary arrived, and no node was ever seen.
            SessionClosed: the client is closed.
        """
        receiver = self._receiver(SummaryMessage.extent, summary_key(self.robot), decode_summary, latched=False)
        return self._judge.wait(receiver, ANY, timeout, Terms(**accepted), says_stale=True).message

    def regions(self, *, timeout: float, **accepted: Unpack[Accepted]) -> RegionsMessage:
        """Return the newest usable steppable regions of the map; wait for them if necessary.

        Arguments and errors are as in `summary`, but the last regions sent before the first call are received too.
        """
        receiver = self._receiver(RegionsMessage.extent, regions_key(self.robot), decode_regions)
        return self._judge.wait(receiver, ANY, timeout, Terms(**accepted), says_stale=True).message

    def _receiver(
        self, extent: str, key: str, decode: Callable[[bytes], G], *, latched: bool = True
    ) -> NewestReceiver[G]:
        """Return the receiver of one kind of grid; the first call subscribes."""
        if extent not in self._receivers:
            self._receivers[extent] = NewestReceiver(
                self._session, key, decode, latched=latched, refusal=lambda grid: self._judge.refusal(grid, extent)
            )
            self._since[extent] = time.monotonic()
        return self._receivers[extent]

    def _first(self, extent: str, within: float) -> Received[TerrainMessage] | None:
        """Return the newest grid, however old, that arrives within this time [s] after the subscription, or None."""
        receiver = self.receiver(extent)
        with suppress(ReceiveTimeout):
            return receiver.wait_until(ANY, max(0.0, self._since[extent] + within - time.monotonic()))
        return None

    def receive(
        self,
        predicate: Callable[[TerrainMessage], bool],
        *,
        timeout: float | None,
        extent: str = "footprint",
        after: int = 0,
        takes_back: bool = False,
        **accepted: Unpack[Accepted],
    ) -> Received[TerrainMessage]:
        """Wait until the newest grid may be used and `predicate` accepts it; return the grid with its time of arrival.

        Args:
            predicate: called with each new grid, or the newest of several; returns True to accept it.
            timeout: longest wait [s]; None = no limit.
            extent: "footprint" or "map".
            after: number of a sample; only samples with larger numbers are considered.
            takes_back: also return a message that withdraws an earlier grid, regardless of `accepted`.
            accepted: as in `latest`.

        Raises:
            ReceiveTimeout: no such grid arrived in time although the node is alive; if stale grids arrived, the error
                message says why the last one could not be used.
            ScannerGone: no such grid arrived, and the node has disappeared.
            ScannerUnavailable: no such grid arrived, and no node was ever seen.
            MessageError: the extent is unknown.
            SessionClosed: the client is closed.
        """
        return self._judge.wait(
            self.receiver(extent),
            lambda received: predicate(received.message),
            timeout,
            Terms(**accepted),
            after=after,
            takes_back=takes_back,
        )

    def wait_for_step(
        self,
        step: int,
        *,
        timeout: float,
        extent: str = "footprint",
        epoch: str | None = None,
        refined_only: bool = False,
        **accepted: Unpack[Accepted],
    ) -> TerrainMessage:
        """Wait for the grid of stance pause `step` or a later one; errors as in `receive`.

        Args:
            step: number of the pause.
            timeout: longest wait [s].
            extent: "footprint" or "map".
            epoch: identity of the walk; None = the current one.
            refined_only: skip a coarse grid that will be followed by a finer one of the same pause.
            accepted: as in `latest`.

        Raises:
            MessageError: the step is no whole number.
        """
        if not isinstance(step, Integral):
            raise MessageError(f"step is {step!r}; allowed: a whole number")

        def predicate(received: Received[TerrainMessage]) -> bool:
            terrain = received.message
            if terrain.step < step or (refined_only and terrain.refinement_follows):
                return False
            if epoch is not None:
                return terrain.epoch == epoch
            if terrain.step > step:
                self._judge.wait_for_news(NEWS)
            return True

        return self._judge.wait(self.receiver(extent), predicate, timeout, Terms(**accepted)).message

    def on_terrain(
        self,
        callback: Callable[[TerrainMessage], None],
        *,
        extent: str = "footprint",
        **accepted: Unpack[Accepted],
    ) -> None:
        """Call `callback` with each new grid, on a separate thread; grids superseded during a call are skipped.

        A grid that may not be used by `accepted` (as in `latest`) is skipped, except one that withdraws another grid:
        it is always passed on, with the reasons why it is stale.

        Raises:
            MessageError: the extent is unknown.
            SessionClosed: the client is closed.
        """
        notices, terms, receiver = Seldom(logger), Terms(**accepted), self.receiver(extent)

        def hand_over(received: Received[TerrainMessage]) -> None:
            # A withdrawal must be delivered, no matter how late it arrives.
            mine = TAKING_BACK if received.message.withdrawn else terms
            newer = partial(receiver.has_newer, received)
            try:
                callback(self._judge.check(received, mine, patience=SETTLE, is_superseded=newer))
            except StaleTerrain as error:
                notices.log("grid skipped: %s", error)

        receiver.on_newest(hand_over)

    def request_scan(
        self,
        *,
        mode: str = "standard",
        timeout: float = 30.0,
        request_id: str | None = None,
        on_progress: Callable[[ScanReply], None] | None = None,
        **accepted: Unpack[Accepted],
    ) -> TerrainMessage:
        """Request a scan and return its grid, or a later one.

        Arguments and further errors are as in `scan_client.request_scan`, `accepted` as in `latest`.

        Raises:
            ReceiveTimeout: the scan is complete, but no usable grid of this scan, or later one, arrived in time.
            ScannerUnavailable: the node is not alive at the start.
            ScannerGone: the node disappeared after the request.
        """
        receiver, start = self.receiver(), time.monotonic()
        if not self.wait_until_alive(min(timeout, SETTLE)):
            raise self._judge.unavailable()
        before = receiver.received
        done = request_scan(
            self._session,
            robot=self.robot,
            mode=mode,
            timeout=timeout,
            request_id=request_id,
            on_progress=on_progress,
            is_alive=lambda: self.is_alive,
        )
        left = max(ARRIVES_WITHIN, start + timeout - time.monotonic())
        return self._judge.wait(receiver, result_of(done, before), left, Terms(**accepted)).message

    def query(
        self,
        *,
        extent: str = "footprint",
        region: tuple[float, float, float, float] | None = None,
        timeout: float = 5.0,
        **accepted: Unpack[Accepted],
    ) -> TerrainMessage:
        """Query the node for its newest grid or a region of that grid; further errors as in `query.query_terrain`.

        Args:
            extent: "footprint" or "map".
            region: (x_min, x_max, y_min, y_max) in the frame of the grid [m]; None = the whole grid.
            timeout: longest wait [s].
            accepted: as in `latest`.

        Raises:
            StaleTerrain: the newest grid may not be used, or there is none yet.
            MessageError: the reply is for another robot, extent or frame, or from another run of the node
                than the current one.
        """
        asked = time.time_ns(), clock.now()
        terrain = query_terrain(
            self._session, robot=self.robot, extent=extent, region=region, timeout=timeout, encoding=self._encoding
        )
        refusal = self._judge.refusal(terrain, extent, is_newest=False)
        if refusal:
            raise MessageError(f"reply on {query_key(self.robot)!r} rejected: {refusal}")
        return self._judge.check(Received(terrain, 0, asked[1], asked[0]), Terms(**accepted), patience=SETTLE)

    def close(self) -> None:
        """Close the session and all receivers; may be called twice."""
        self._session.close()
