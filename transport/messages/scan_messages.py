"""Scan requests, grid queries and their replies, with their CDR payloads."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from transport.exceptions import MessageError, check_choice
from transport.messages.codec import decode, encode, from_ros, to_ros
from transport.messages.submessages import finite
from transport.messages.terrain_message import EXTENTS, MODES
from transport.messages.typestore import QUERY_REQUEST, REFUSAL, SCAN_REPLY, SCAN_REQUEST, SENTENCE, check_value

# Longest request id [characters].
MAXIMUM_ID = 200
LIMITS = ("x_min", "x_max", "y_min", "y_max")


class ScanState(IntEnum):
    """State of a scan request."""

    ACCEPTED = 1
    PROGRESS = 2
    DONE = 3
    FAILED = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanRequest:
    """Request for a scan.

    Attributes:
        id: unique id; a repeated request with the same id returns the same scan.
        mode: "coarse" or "standard".
        timeout: time after the arrival of the request at which the scanner cancels the scan [s].
    """

    id: str
    mode: str
    timeout: float

    def __post_init__(self) -> None:
        """Check the fields.

        Raises:
            MessageError: a value is not allowed.
        """
        if not 0 < len(self.id) <= MAXIMUM_ID:
            raise MessageError(f"id of the request has {len(self.id)} characters; allowed: 1 to {MAXIMUM_ID}")
        check_choice("mode", self.mode, MODES)
        if finite(self.timeout, "timeout") <= 0.0:
            raise MessageError(f"timeout is {self.timeout} s; allowed: more than 0")
        check_value(SCAN_REQUEST, "timeout", self.timeout)


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanReply:
    """Reply of the scanner to a ScanRequest.

    Attributes:
        id: id of the request.
        state: ACCEPTED or PROGRESS, or the final state DONE or FAILED.
        stripes_done: number of stripes scanned so far.
        stripes_total: number of stripes of the scan.
        step: if DONE, number of the pause.
        sequence: if DONE, sequence number of the terrain message, which is normally sent before this reply.
        stamp: if DONE, stamp of the terrain message [ns since the Unix epoch].
        code: if FAILED, short name of the cause.
        message: if FAILED, description of the cause.
    """

    id: str
    state: ScanState
    stripes_done: int = 0
    stripes_total: int = 0
    step: int = 0
    sequence: int = 0
    stamp: int = 0
    code: str = ""
    message: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Refusal:
    """Refusal of a scan request or query.

    Attributes:
        id: id of the scan request; empty if it could not be read, and for queries.
        code: short name of the cause, such as "busy", "bad_request", "not_stationary" or "no_terrain".
        message: description of the cause.
    """

    id: str
    code: str
    message: str


@dataclass(frozen=True, slots=True, kw_only=True)
class QueryRequest:
    """Query for the newest grid or a region of that grid.

    Attributes:
        extent: "footprint" or "map".
        region: (x_min, x_max, y_min, y_max) in the frame of the grid [m]; None = the whole grid.
    """

    extent: str = "footprint"
    region: tuple[float, float, float, float] | None = None

    def __post_init__(self) -> None:
        """Check the fields.

        Raises:
            MessageError: a value is not allowed.
        """
        check_choice("extent", self.extent, EXTENTS)
        if self.region is None:
            return
        if len(self.region) != 4:
            raise MessageError(f"region has {len(self.region)} numbers; allowed: x_min, x_max, y_min, y_max")
        x_min, x_max, y_min, y_max = (finite(limit, "limit of the region") for limit in self.region)
        if x_min >= x_max or y_min >= y_max:
            raise MessageError(f"region {self.region} is empty; x_min < x_max and y_min < y_max are needed")
        object.__setattr__(self, "region", (x_min, x_max, y_min, y_max))


def encode_scan_request(request: ScanRequest) -> bytearray:
    """Encode a ScanRequest as CDR."""
    return encode(to_ros(SCAN_REQUEST, request))


def decode_scan_request(payload: bytes) -> ScanRequest:
    """Decode a ScanRequest; MessageError if the payload is damaged or a value is not allowed."""
    return from_ros(ScanRequest, decode(payload, SCAN_REQUEST))


def encode_scan_reply(reply: ScanReply) -> bytearray:
    """Encode a ScanReply as CDR; the text in `message` is truncated if it is too long."""
    return encode(to_ros(SCAN_REPLY, reply, message=SENTENCE.cut(reply.message)))


def decode_scan_reply(payload: bytes) -> ScanReply:
    """Decode a ScanReply; MessageError if the payload is damaged or a value is not allowed."""
    message = decode(payload, SCAN_REPLY)
    return from_ros(ScanReply, message, state=ScanState(message.state))


def encode_refusal(refusal: Refusal) -> bytearray:
    """Encode a Refusal as CDR; the text in `message` is truncated if it is too long."""
    return encode(to_ros(REFUSAL, refusal, message=SENTENCE.cut(refusal.message)))


def decode_refusal(payload: bytes) -> Refusal:
    """Decode a Refusal; MessageError if the payload is damaged or a value is not allowed."""
    return from_ros(Refusal, decode(payload, REFUSAL))


def encode_query_request(request: QueryRequest) -> bytearray:
    """Encode a QueryRequest as CDR."""
    limits = dict(zip(LIMITS, request.region or (0.0, 0.0, 0.0, 0.0), strict=True))
    return encode(to_ros(QUERY_REQUEST, request, whole=request.region is None, **limits))


def decode_query_request(payload: bytes) -> QueryRequest:
    """Decode a QueryRequest; MessageError if the payload is damaged or a value is not allowed."""
    message = decode(payload, QUERY_REQUEST)
    region = None if message.whole else tuple(getattr(message, name) for name in LIMITS)
    return from_ros(QueryRequest, message, region=region)
