"""Queries for the newest grid or a region of it: server and client."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from transport.exceptions import (
    MessageError,
    OperationFailed,
    ReceiveTimeout,
    ScannerUnavailable,
    StaleTerrain,
    TransportError,
)
from transport.keys import DEFAULT_ROBOT, check_encoding, query_key
from transport.links.answerer import Answerer, refuse
from transport.links.session import Session
from transport.messages.scan_messages import (
    QueryRequest,
    decode_query_request,
    decode_refusal,
    encode_query_request,
)
from transport.messages.terrain_message import (
    TerrainMessage,
    crop_terrain,
    decode_terrain,
    encode_compact,
    encode_terrain,
)
from transport.messages.typestore import QUERY_REQUEST, TERRAIN, cdr, compact
from transport.queries.asking import TIMED_OUT, ask

# Largest number of pending queries; further queries are dropped.
MAXIMUM_ANSWERS = 16

Provider = Callable[[str], TerrainMessage | None]


class QueryServer(Answerer):
    """Server of queries for the newest grid of a robot."""

    def __init__(self, session: Session, provider: Provider, *, robot: str = DEFAULT_ROBOT) -> None:
        """Declare the queryable; `provider(extent)` returns the newest message or None, and must not block."""
        self._provider = provider
        super().__init__(session, query_key(robot), self._reply, limit=MAXIMUM_ANSWERS)

    def _reply(self, query: Any) -> None:
        try:
            request = decode_query_request(query.payload.to_bytes() if query.payload is not None else b"")
            terrain = self._provider(request.extent)
            if terrain is None:
                refuse(query, "no_terrain", f"there is no grid of extent {request.extent!r} yet")
                return
            if request.region is not None:
                terrain = crop_terrain(terrain, request.region)
            if query.parameters.get("encoding") == "compact":
                query.reply(self.key, encode_compact(terrain), encoding=compact(TERRAIN))
            else:
                query.reply(self.key, encode_terrain(terrain), encoding=cdr(TERRAIN))
        except MessageError as error:
            refuse(query, "bad_request", str(error))


def query_terrain(
    session: Session,
    *,
    robot: str = DEFAULT_ROBOT,
    extent: str = "footprint",
    region: tuple[float, float, float, float] | None = None,
    timeout: float = 5.0,
    encoding: str = "lossless",
) -> TerrainMessage:
    """Query the newest grid, or its cells that overlap a region.

    Args:
        session: open session.
        robot: instance name.
        extent: "footprint" or "map".
        region: (x_min, x_max, y_min, y_max) in the frame of the grid [m]; None = the whole grid.
        timeout: time granted to the node [s]; the wait may be 0.5 s longer.
        encoding: "lossless" or "compact"; nodes of earlier versions always send lossless replies.

    Raises:
        KeyNameError: the encoding is unknown, or the robot's name cannot be part of a key.
        MessageError: the extent is unknown, the region is not valid or outside the grid, or the reply is damaged.
        StaleTerrain: the node has no grid yet.
        ScannerUnavailable: no node replies: none is running, the node has too many pending queries, or this client may
            not query it.
        ReceiveTimeout: no reply arrived in time.
        SessionClosed: the session is closed.
        OperationFailed: the node or Zenoh refused the query for another reason.
    """
    request = QueryRequest(extent=extent, region=region)
    payload = encode_query_request(request)
    selector = query_key(robot) + ("" if check_encoding(encoding) == "lossless" else f"?encoding={encoding}")
    for answer in ask(session, selector, payload, timeout, priority="DATA", encoding=cdr(QUERY_REQUEST)):
        if answer.payload is not None:
            return decode_terrain(answer.payload)
        if answer.error is not None:
            refusal = decode_refusal(answer.error)
            kinds: dict[str, type[TransportError]] = {"no_terrain": StaleTerrain, "bad_request": MessageError}
            raise kinds.get(refusal.code, OperationFailed)(refusal.message)
        if answer is TIMED_OUT:
            raise ReceiveTimeout(f"no reply on {query_key(robot)!r} within {timeout:g} s")
    raise ScannerUnavailable(
        f"no node replies on {query_key(robot)!r}: no node of robot {robot!r} is running, or the role of this "
        f"client's certificate does not permit queries"
    )
