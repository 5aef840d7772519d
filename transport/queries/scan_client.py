"""Client for scan requests: sends a request, follows its progress, and raises an exception if it fails."""

from __future__ import annotations

import time
import uuid
from collections.abc import Callable
from typing import NoReturn

from transport.exceptions import (
    MessageError,
    ScanBusy,
    ScanFailed,
    ScannerGone,
    ScannerUnavailable,
    ScanTimeout,
)
from transport.keys import DEFAULT_ROBOT, scan_key
from transport.links.received import Received
from transport.links.session import Session
from transport.messages.scan_messages import (
    Refusal,
    ScanReply,
    ScanRequest,
    ScanState,
    decode_refusal,
    decode_scan_reply,
    encode_scan_request,
)
from transport.messages.terrain_message import TerrainMessage
from transport.messages.typestore import SCAN_REQUEST, cdr
from transport.queries.asking import TIMED_OUT, VANISHED, ask

# Time within which the end of a process is detected [s].
GONE_WITHIN = 0.5
# Minimum time to wait for a grid after its scan was reported as done [s].
ARRIVES_WITHIN = 2.0


def request_scan(
    session: Session,
    *,
    robot: str = DEFAULT_ROBOT,
    mode: str = "standard",
    timeout: float = 30.0,
    request_id: str | None = None,
    on_progress: Callable[[ScanReply], None] | None = None,
    is_alive: Callable[[], bool] | None = None,
) -> ScanReply:
    """Request a scan and wait until it is done.

    Args:
        session: open session.
        robot: instance name.
        mode: "coarse" or "standard".
        timeout: time within which the scan must be done [s]; Ctrl-C ends the wait.
        request_id: id of the request; repeating an id returns the same scan instead of a second one. None = a new id.
        on_progress: called on the calling thread with each PROGRESS reply.
        is_alive: returns True while the node is alive; with it, a hung node is detected before the timeout.

    Returns:
        The DONE reply, with step and sequence number of the terrain message, which is normally sent before the reply.

    Raises:
        KeyNameError: the robot's name cannot be part of a key.
        MessageError: another argument is not allowed, or a reply is damaged or belongs to another request.
        ScannerUnavailable: no scanner replies: none is running, or this client may not request scans.
        ScanBusy: the scanner is working on another request.
        ScanFailed: the scanner refused the request or could not complete the scan; `code` is the cause.
        ScanTimeout: the scan was not done in time.
        ScannerGone: the node disappeared during the scan, or before it replied.
        SessionClosed: the session is closed.
        TransportError: Zenoh rejected the request.
    """
    request = ScanRequest(id=request_id or uuid.uuid4().hex, mode=mode, timeout=timeout)
    payload, encoding = encode_scan_request(request), cdr(SCAN_REQUEST)

    def asked(timeout: float) -> ScanReply | None:
        """Send the request and follow it; return the DONE reply, or None if there is no reply at all."""
        accepted = False
        for answer in ask(session, scan_key(robot), payload, timeout, is_alive=is_alive, encoding=encoding):
            if answer.payload is not None:
                reply = decode_scan_reply(answer.payload)
                if reply.id != request.id:
                    raise MessageError(f"the reply belongs to request {reply.id!r}, not to {request.id!r}")
                if reply.state is ScanState.DONE:
                    return reply
                if reply.state is ScanState.FAILED:
                    _raise_failure(reply.code, reply.message, request.timeout)
                accepted = True
                if reply.state is ScanState.PROGRESS and on_progress is not None:
                    on_progress(reply)
            elif answer.error is not None:
                refusal = _read_refusal(answer.error)
                _raise_failure(refusal.code, refusal.message, request.timeout)
            elif answer is TIMED_OUT:
                progress = "it was accepted" if accepted else "no reply"
                raise ScanTimeout(f"scan not done within {request.timeout:g} s ({progress})")
            elif accepted or answer is VANISHED:
                raise ScannerGone(
                    f"the scanner of {robot!r} disappeared before the end of the scan: its node died, hung or lost its "
                    "link"
                )
        return None

    deadline = time.monotonic() + timeout
    for is_repeated in (False, True):
        was_alive = is_alive is not None and is_alive()
        left = timeout if not is_repeated else deadline - time.monotonic()
        reply = asked(left) if left > 0 else None
        if reply is not None:
            return reply
        if is_alive is None or not was_alive or is_repeated:
            break
        if _has_gone(is_alive):
            raise ScannerGone(f"the node of {robot!r} disappeared before it replied")
        # When a node starts, a client may see its token slightly before its queryable, so try once more.
    raise ScannerUnavailable(
        f"no scanner replies on {scan_key(robot)!r}: no node of robot {robot!r} is running, or the role of this "
        "client's certificate does not permit scan requests"
    )


def result_of(done: ScanReply, before: int) -> Callable[[Received[TerrainMessage]], bool]:
    """Return a predicate that accepts the grid of a requested scan, or a later grid.

    Args:
        done: DONE reply to the request.
        before: number of samples received before the request.
    """

    def is_result(received: Received[TerrainMessage]) -> bool:
        terrain = received.message
        # Sequence numbers restart with the node, so a later number counts only if the sample arrived after the request.
        is_later = received.number > before and terrain.sequence > done.sequence
        return is_later or (terrain.sequence, terrain.stamp) == (done.sequence, done.stamp)

    return is_result


def _has_gone(is_alive: Callable[[], bool]) -> bool:
    """Wait up to `GONE_WITHIN` until the node is no longer alive; return True if that happens.

    The client may see the end of the node's replies before the node's token disappears.
    """
    deadline = time.monotonic() + GONE_WITHIN
    while is_alive():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.01)
    return True


def _read_refusal(payload: bytes) -> Refusal:
    try:
        return decode_refusal(payload)
    except MessageError:
        # An error reply of Zenoh itself is plain text.
        return Refusal(id="", code="failed", message=payload[:200].decode("utf-8", "replace"))


def _raise_failure(code: str, message: str, timeout: float) -> NoReturn:
    if code == "busy":
        raise ScanBusy(message)
    if code in ("timeout", "expired"):
        raise ScanTimeout(f"scan not done within {timeout:g} s: {message}")
    raise ScanFailed(f"scan failed ({code}): {message}", code)
