"""A planner's or viewer's side of the transport, whole: the newest grid, scan requests, queries, sign of life."""

from __future__ import annotations

import time
from collections.abc import Callable
from types import TracebackType
from typing import Self

from transport.exceptions import (
    MessageError,
    ReceiveTimeout,
    ScannerGone,
    ScannerUnavailable,
    StaleTerrain,
)
from transport.keys import DEFAULT_ROBOT, alive_key, status_key, terrain_key
from transport.liveliness import AliveWatcher
from transport.query import query_terrain
from transport.receiver import NewestReceiver, Received
from transport.scan_client import request_scan
from transport.scan_messages import ScanReply
from transport.session import Session
from transport.status_message import STATUS_NAME, Status, decode_status
from transport.terrain_codec import decode_terrain
from transport.terrain_message import EXTENTS, TerrainMessage

# [s] After subscribing, the last grid and the node's sign of life are there within this time: measured below 0.1 s on
# a free machine, the rest is for a busy one. Only who asks in vain waits so long.
SETTLE = 2.0

NS = 1e-9


class PerceptionClient:
    """Receives the grids of one robot and asks it for scans.

    Each extent is subscribed to when first asked for. A grid's age is the time since its arrival plus the time
    between the end of its scan and its arrival by the two machines' clocks (never less than nothing).

    Attributes:
        robot: instance name.
    """

    def __init__(self, session: Session, *, robot: str = DEFAULT_ROBOT) -> None:
        """Watch the node and its status.

        Args:
            session: open session; closing the client closes it.
            robot: instance name.
        """
        self.robot = robot
        self._session = session
        self._receivers: dict[str, NewestReceiver[TerrainMessage]] = {}
        self._since: dict[str, float] = {}
        self._start = time.monotonic()
        self._node = AliveWatcher(session, alive_key(robot))
        self._status = NewestReceiver(session, status_key(robot), decode_status, latched=False)

    def __enter__(self) -> Self:
        """The client itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
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
        if extent not in self._receivers:
            key = terrain_key(self.robot, extent)
            self._receivers[extent] = NewestReceiver(self._session, key, decode_terrain)
            self._since[extent] = time.monotonic()
        return self._receivers[extent]

    @property
    def is_alive(self) -> bool:
        """Whether the node shows its sign of life."""
        return self._node.is_alive

    def wait_until_alive(self, timeout: float) -> bool:
        """Wait for the node's sign of life; False when `timeout` [s] passed before."""
        return self._node.wait(True, timeout)

    def links(self) -> tuple[str, ...]:
        """Routers that this client is connected to now."""
        return self._session.links()

    def status(self) -> Status | None:
        """The newest status of the node, or None when none came yet.

        Raises:
            MessageError: the newest status is damaged.
        """
        received = self._status.latest()
        return None if received is None else received.message

    def age(self, received: Received[TerrainMessage]) -> float:
        """[s] since the end of the scan of a received grid."""
        return received.age + max(0.0, (received.arrival_stamp - received.message.scan_end) * NS)

    def latest(self, *, extent: str = "footprint", max_age: float | None = None) -> TerrainMessage:
        """The newest grid, if it may still be used.

        Args:
            extent: "footprint" or "map".
            max_age: [s] since the end of the scan; None takes the grid's own validity, in time and in pauses.

        Raises:
            StaleTerrain: the newest grid is too old, or there is none yet.
            ScannerUnavailable: there is no grid and no node.
            MessageError: the newest sample is no valid grid.
        """
        receiver = self.receiver(extent)
        received = receiver.latest()
        if received is None:
            received = self._first(receiver, self._since[extent] + SETTLE - time.monotonic())
        if received is None:
            if self.is_alive:
                raise StaleTerrain(f"the node of {self.robot!r} runs, but has published no {extent} grid yet")
            raise self._unavailable()
        terrain, age = received.message, self.age(received)
        limit = terrain.valid_for if max_age is None else max_age
        if age > limit:
            gone = "" if self.is_alive else "; its node is gone"
            raise StaleTerrain(
                f"newest {extent} grid (step {terrain.step}) is {age:.2f} s old; allowed: {limit:g} s{gone}. "
                f"Wait for the next, ask for a scan, or give a larger max_age"
            )
        pauses = self._pauses_since(terrain)
        if max_age is None and pauses > terrain.valid_pauses:
            raise StaleTerrain(
                f"newest {extent} grid (step {terrain.step}) is {pauses} pauses old; allowed: "
                f"{terrain.valid_pauses}. Wait for the next, ask for a scan, or give max_age"
            )
        return terrain

    def _first(self, receiver: NewestReceiver[TerrainMessage], timeout: float) -> Received[TerrainMessage] | None:
        try:
            return receiver.wait_for(lambda _: True, max(0.0, timeout))
        except ReceiveTimeout:
            return None

    def _pauses_since(self, terrain: TerrainMessage) -> int:
        status = self.status()
        item = None if status is None else status.item(STATUS_NAME)
        step = "" if item is None else item.values.get("step", "")
        return int(step) - terrain.step if step.lstrip("-").isdigit() else 0

    def _unavailable(self) -> ScannerUnavailable:
        return ScannerUnavailable(
            f"no node of robot {self.robot!r} is to be seen: none runs on this router, the instance name "
            f"differs, or this side may not read (the role of its certificate)"
        )

    def wait_for(
        self, predicate: Callable[[TerrainMessage], bool], *, timeout: float, extent: str = "footprint"
    ) -> TerrainMessage:
        """Wait for a newest grid that `predicate` accepts.

        Raises:
            ReceiveTimeout: none came within `timeout` [s] although the node lives.
            ScannerGone: none came, and the node went away.
            ScannerUnavailable: none came, and no node was ever seen.
        """
        try:
            return self.receiver(extent).wait_for(predicate, timeout).message
        except ReceiveTimeout as error:
            if self.is_alive:
                raise
            if self._node.was_seen:
                raise ScannerGone(f"{error}; the node of {self.robot!r} went away") from error
            raise self._unavailable() from error

    def wait_for_step(
        self, step: int, *, timeout: float, extent: str = "footprint", confirmed: bool = False
    ) -> TerrainMessage:
        """Wait for the grid of stance pause `step` or a later one; errors as of `wait_for`."""
        return self.wait_for(
            lambda terrain: terrain.step >= step and not (confirmed and terrain.provisional),
            timeout=timeout,
            extent=extent,
        )

    def on_terrain(self, callback: Callable[[TerrainMessage], None], *, extent: str = "footprint") -> None:
        """Call `callback` with the newest grid, again and again, on a thread of its own; see `on_newest`."""
        self.receiver(extent).on_newest(lambda received: callback(received.message))

    def request_scan(
        self,
        *,
        mode: str = "standard",
        timeout: float = 30.0,
        request_id: str | None = None,
        on_progress: Callable[[ScanReply], None] | None = None,
    ) -> TerrainMessage:
        """Ask for a scan and return its grid; arguments and errors as of `scan_client.request_scan`.

        Raises:
            ReceiveTimeout: the scan was done, but its grid did not arrive in time.
        """
        start = time.monotonic()
        receiver = self.receiver()
        before = receiver.received
        if not self.wait_until_alive(min(timeout, SETTLE)):
            raise self._unavailable()
        done = request_scan(
            self._session,
            robot=self.robot,
            mode=mode,
            timeout=timeout,
            request_id=request_id,
            on_progress=on_progress,
            is_alive=lambda: self.is_alive,
        )
        remaining = max(SETTLE, start + timeout - time.monotonic())

        def is_result(received: Received[TerrainMessage]) -> bool:
            terrain = received.message
            # Sequences start anew with the node: a later number counts only for what came after the request.
            is_later = received.number > before and terrain.sequence > done.sequence
            return is_later or (terrain.sequence, terrain.stamp) == (done.sequence, done.stamp)

        return receiver.wait_until(is_result, remaining).message

    def query(
        self,
        *,
        extent: str = "footprint",
        region: tuple[float, float, float, float] | None = None,
        timeout: float = 5.0,
    ) -> TerrainMessage:
        """Ask the node for its newest grid or a region of it; errors as of `query.query_terrain`."""
        return query_terrain(self._session, robot=self.robot, extent=extent, region=region, timeout=timeout)

    def close(self) -> None:
        """Close the session with all receivers; safe to call twice."""
        self._session.close()
