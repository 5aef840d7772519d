"""Transport of a planner or viewer: newest grids, scan requests, queries, liveliness."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from functools import partial
from typing import Any, Self, Unpack

from transport import clock
from transport.exceptions import MessageError, StaleTerrain
from transport.grids.evidence import G
from transport.grids.grid_judge import TAKING_BACK, Accepted, GridJudge, Terms
from transport.grids.grid_waiter import SETTLE, GridWaiter
from transport.grids.node_clock import ClockOffset
from transport.keys import DEFAULT_ROBOT, check_encoding, query_key, regions_key, summary_key, terrain_key
from transport.links.received import Received
from transport.links.receiver import NewestReceiver
from transport.links.session import Session
from transport.messages.map_messages import RegionsMessage, SummaryMessage, decode_regions, decode_summary
from transport.messages.scan_messages import ScanReply
from transport.messages.status_message import Status
from transport.messages.terrain_codec import decode_terrain
from transport.messages.terrain_message import EXTENTS, TerrainMessage
from transport.queries.query import query_terrain
from transport.queries.scan_client import ARRIVES_WITHIN, request_scan, result_of
from transport.supervision import Seldom

# [s] A living node delivers its last grid within this time, even over a slow link or from a busy machine.
FIRST_GRID = 5.0

logger = logging.getLogger(__name__)


class PerceptionClient:
    """Client of one robot: receives its grids and requests scans.

    Each extent is subscribed to at its first use. `GridJudge` accepts or rejects each grid by sender and age.

    Attributes:
        robot: instance name.
    """

    def __init__(self, session: Session, *, robot: str = DEFAULT_ROBOT, encoding: str = "lossless") -> None:
        """Watch the node and its status.

        Args:
            session: open session; closing the client closes it.
            robot: instance name.
            encoding: encoding of the grids: "lossless" or "compact" (`transport.messages.terrain_codec`).

        Raises:
            KeyNameError: unknown encoding.
        """
        self.robot = robot
        self._encoding = check_encoding(encoding)
        self._session = session
        self._receivers: dict[str, NewestReceiver[Any]] = {}
        self._since: dict[str, float] = {}
        self._judge = GridJudge(session, robot)
        self._waiter = GridWaiter(session, self._judge, robot)

    def __enter__(self) -> Self:
        """The client itself."""
        return self

    def __exit__(self, *error: object) -> None:
        """Close."""
        self.close()

    def receiver(self, extent: str = "footprint") -> NewestReceiver[TerrainMessage]:
        """The receiver of one extent, with its counts received, superseded, missed and rejected.

        Raises:
            MessageError: unknown extent.
            SessionClosed: the client is closed.
        """
        if extent not in EXTENTS:
            raise MessageError(f"extent is {extent!r}; allowed: {', '.join(map(repr, EXTENTS))}")
        return self._receiver(extent, terrain_key(self.robot, extent, self._encoding), decode_terrain)

    @property
    def is_alive(self) -> bool:
        """True while the liveliness token of the node is there."""
        return self._judge.node.is_alive

    def wait_until_alive(self, timeout: float) -> bool:
        """Wait until the node is alive; False when `timeout` [s] passed before."""
        return self._judge.node.wait(True, timeout)

    def links(self) -> tuple[str, ...]:
        """Addresses to which this client is connected."""
        return self._session.links()

    def status(self) -> Status | None:
        """The newest status of the node, or None when none came yet.

        Raises:
            MessageError: the newest status is damaged.
        """
        return self._judge.status()

    @property
    def clock_offset(self) -> ClockOffset | None:
        """Offset of the node's wall clock from this machine's; None while the node has not reported it."""
        return self._judge.clock.offset

    def age(self, received: Received[TerrainMessage]) -> float:
        """Time since the end of the scan of a received grid [s]; see `GridJudge.age`."""
        return self._judge.age(received)

    def latest(self, *, extent: str = "footprint", **accepted: Unpack[Accepted]) -> TerrainMessage:
        """Newest grid, if it may be used.

        Args:
            extent: "footprint" or "map".
            accepted: fields of `Terms`: `max_age` stretches the age alone; with `allow_stale` a grid says in
                `stale_because` why it would not be handed out otherwise.

        Raises:
            StaleTerrain: the newest grid may not be used, or there is none yet.
            ScannerUnavailable: there is no grid and no node.
            MessageError: the newest sample is no valid grid.
        """
        receiver = self.receiver(extent)
        received = receiver.latest() or self._first(extent, SETTLE)
        if received is None and self.is_alive:
            received = self._first(extent, FIRST_GRID)
        if received is None:
            if self.is_alive:
                older = "" if self._encoding == "lossless" else "; nodes of earlier versions have none in 'compact'"
                raise StaleTerrain(f"the node of {self.robot!r} runs, but has published no {extent} grid yet{older}")
            raise self._waiter.unavailable()
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
        """Newest summary of the map that may be used, waited for if there is none.

        Summaries have no history: those sent before the first call are not received. Invalid samples are skipped.

        Args:
            timeout: [s] to wait for one that may be used.
            accepted: as in `latest`.

        Raises:
            StaleTerrain: the newest may not be used and no newer one came in time.
            ReceiveTimeout: none came although the node lives.
            ScannerGone, ScannerUnavailable: none came, and the node went away or was never seen.
        """
        receiver = self._receiver(SummaryMessage.extent, summary_key(self.robot), decode_summary, latched=False)
        return self._waiter.newest(receiver, timeout, Terms(**accepted))

    def regions(self, *, timeout: float, **accepted: Unpack[Accepted]) -> RegionsMessage:
        """Steppable regions of the newest map that may be used, waited for as in `summary`.

        Arguments and errors as in `summary`. The last regions sent before the first call are received too.
        """
        receiver = self._receiver(RegionsMessage.extent, regions_key(self.robot), decode_regions)
        return self._waiter.newest(receiver, timeout, Terms(**accepted))

    def _receiver(
        self, extent: str, key: str, decode: Callable[[bytes], G], *, latched: bool = True
    ) -> NewestReceiver[G]:
        """The receiver of one kind of grid, subscribed to at its first use."""
        if extent not in self._receivers:
            self._receivers[extent] = NewestReceiver(
                self._session, key, decode, latched=latched, refusal=lambda grid: self._judge.refusal(grid, extent)
            )
            self._since[extent] = time.monotonic()
        return self._receivers[extent]

    def _first(self, extent: str, within: float) -> Received[TerrainMessage] | None:
        return self._waiter.first(self.receiver(extent), self._since[extent] + within - time.monotonic())

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
        """Wait until the newest grid is one that `predicate` accepts and that may be used.

        Args:
            predicate: called with each newest grid.
            timeout: longest wait [s]; None waits without end.
            extent: "footprint" or "map".
            after: number of a sample; only later ones count.
            takes_back: return a message that withdraws an earlier grid too, whatever is accepted.
            accepted: as in `latest`.

        Raises:
            ReceiveTimeout: none came in time although the node lives; the message says so when only stale ones came.
            ScannerGone: none came, and the node went away.
            ScannerUnavailable: none came, and no node was ever seen.
        """
        return self._waiter.wait(
            self.receiver(extent),
            lambda received: predicate(received.message),
            timeout,
            Terms(**accepted),
            after=after,
            takes_back=takes_back,
        )

    def wait_for(
        self,
        predicate: Callable[[TerrainMessage], bool],
        *,
        timeout: float,
        extent: str = "footprint",
        **accepted: Unpack[Accepted],
    ) -> TerrainMessage:
        """Wait until the newest grid is one that `predicate` accepts; arguments and errors as in `receive`."""
        return self.receive(predicate, timeout=timeout, extent=extent, **accepted).message

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
            epoch: identity of the walk; None = the one that the node is on.
            refined_only: skip a coarse grid that a finer one of the same pause follows.
            accepted: as in `latest`.
        """
        predicate = self._waiter.is_of_step(step, epoch, refined_only=refined_only)
        return self._waiter.wait(self.receiver(extent), predicate, timeout, Terms(**accepted)).message

    def on_terrain(
        self,
        callback: Callable[[TerrainMessage], None],
        *,
        extent: str = "footprint",
        **accepted: Unpack[Accepted],
    ) -> None:
        """Call `callback` with the newest grid, again and again, on a thread of its own; see `on_newest`.

        A grid that may not be used by then is skipped. One that withdraws another is always passed on, with the
        objections to it.
        """
        notices, terms, receiver = Seldom(logger), Terms(**accepted), self.receiver(extent)

        def hand_over(received: Received[TerrainMessage]) -> None:
            # A withdrawal must arrive, however late.
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
        """Ask for a scan and return its grid; arguments and errors as in `scan_client.request_scan`.

        Raises:
            ReceiveTimeout: the scan was done, but no grid of it that may be used arrived in time.
        """
        receiver, start = self.receiver(), time.monotonic()
        if not self.wait_until_alive(min(timeout, SETTLE)):
            raise self._waiter.unavailable()
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
        return self._waiter.wait(receiver, result_of(done, before), left, Terms(**accepted)).message

    def query(
        self,
        *,
        extent: str = "footprint",
        region: tuple[float, float, float, float] | None = None,
        timeout: float = 5.0,
        **accepted: Unpack[Accepted],
    ) -> TerrainMessage:
        """Ask the node for its newest grid or a region of it; errors as in `query.query_terrain`.

        Args:
            extent: "footprint" or "map".
            region: [m] (x_min, x_max, y_min, y_max) in the frame of the grid; None for all of it.
            timeout: longest wait [s].
            accepted: as in `latest`.

        Raises:
            StaleTerrain: the newest grid may not be used, or there is none yet.
            MessageError: the answer is of another robot, extent or frame, or of a node that no longer runs.
        """
        asked = time.time_ns(), clock.now()
        terrain = query_terrain(
            self._session, robot=self.robot, extent=extent, region=region, timeout=timeout, encoding=self._encoding
        )
        refusal = self._judge.refusal(terrain, extent, is_newest=False)
        if refusal:
            raise MessageError(f"answer on {query_key(self.robot)!r} not taken: {refusal}")
        return self._judge.check(Received(terrain, 0, asked[1], asked[0]), Terms(**accepted), patience=SETTLE)

    def close(self) -> None:
        """Close the session with all receivers; safe to call twice."""
        self._session.close()
