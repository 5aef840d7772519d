"""Encoding of ROS 2 message objects as CDR and decoding; every failure raises MessageError."""

from __future__ import annotations

from typing import Any

from transport.exceptions import MessageError, VersionError
from transport.messages.ranges import check_ranges
from transport.messages.typestore import TIME, message_class, typestore

# [byte] Larger payloads are rejected unread; a map with all layers has under 2 MB.
MAXIMUM_PAYLOAD = 64 * 1024 * 1024


def encode(message: Any) -> bytearray:
    """Serialise a ROS 2 message object as CDR, little endian, with the 4-byte header.

    Args:
        message: instance of a class from `message_class`. Arrays must be flat and of the exact dtype.

    Returns:
        The payload as a contiguous object for Zenoh and MCAP, without a further copy, which would cost more than the
        encoding.

    Raises:
        MessageError: a field does not fit its type.
    """
    name = getattr(message, "__msgtype__", None)
    if name is None:
        raise MessageError(f"{type(message).__name__} is not a ROS 2 message object; make one with message_class")
    try:
        view = typestore().serialize_cdr(message, name, little_endian=True)
    except Exception as error:  # the generated code of rosbags may raise anything
        raise MessageError(f"cannot encode {name}: {error}") from error
    whole = view.obj
    return whole if isinstance(whole, bytearray) and len(whole) == len(view) else bytearray(view)


def decode(payload: bytes | bytearray | memoryview, type_name: str) -> Any:
    """Deserialise a CDR payload of either byte order as a ROS 2 type.

    Args:
        payload: CDR with the 4-byte header.
        type_name: for example `nav_msgs/msg/OccupancyGrid`.

    Returns:
        The message object. Its arrays are read-only views of `payload`.

    Raises:
        MessageError: the payload is too long, truncated, has trailing bytes or does not fit the type, or a field is
            outside its range in `transport.messages.ranges`.
    """
    message_class(type_name)
    if len(payload) > MAXIMUM_PAYLOAD:
        raise MessageError(f"{type_name} of {len(payload)} bytes refused; allowed: {MAXIMUM_PAYLOAD} bytes")
    try:
        message = typestore().deserialize_cdr(memoryview(payload).toreadonly(), type_name)
    except Exception as error:  # a hostile payload may make the generated code raise anything
        raise MessageError(f"{len(payload)} bytes are not a {type_name}: {error}") from error
    check_ranges(message)
    return message


def make_time(stamp: int) -> Any:
    """Make a builtin_interfaces/Time from nanoseconds since the epoch.

    Raises:
        MessageError: the time is negative or after January 2038, the last that the type can hold.
    """
    seconds, nanoseconds = divmod(int(stamp), 1_000_000_000)
    if not 0 <= seconds < 2**31:
        raise MessageError(f"stamp {stamp} ns is out of range; allowed: 0 to {2**31 * 1_000_000_000 - 1} ns")
    return message_class(TIME)(seconds, nanoseconds)


def read_time(time: Any) -> int:
    """Nanoseconds since the epoch from a builtin_interfaces/Time.

    Raises:
        MessageError: negative seconds or more than 999999999 nanoseconds.
    """
    if time.sec < 0 or time.nanosec >= 1_000_000_000:
        raise MessageError(f"time of {time.sec} s and {time.nanosec} ns is not valid")
    return int(time.sec) * 1_000_000_000 + int(time.nanosec)


def make_header(stamp: int, frame_id: str) -> Any:
    """Make a std_msgs/Header; the stamp is in nanoseconds since the epoch."""
    return message_class("std_msgs/msg/Header")(make_time(stamp), frame_id)


def check_version(message: Any, name: str, major: int) -> None:
    """Check the major version of a message object.

    Raises:
        VersionError: it is not `major`.
    """
    if message.version_major != major:
        raise VersionError(
            f"{name} of version {message.version_major}.{message.version_minor}; this package speaks version "
            f"{major}: install the node's version here, or this one on the node"
        )
