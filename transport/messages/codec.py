"""Conversion of dataclasses to ROS 2 message objects and CDR, and back, driven by the `.msg` definitions.

`encode`, `decode` and `from_ros` report every failure as MessageError.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any, TypeVar

import numpy as np

from transport.exceptions import MessageError, TransportError, VersionError
from transport.messages.quaternions import matrix_from_quaternion, quaternion_from_matrix
from transport.messages.submessages import GroundPatch, ObstacleMessage, Point, StanceMessage, TransformMessage
from transport.messages.typestore import ARRAYS, SUBMESSAGE, TIME, check_ranges, message_class, typestore

T = TypeVar("T")
# Largest payload that is decoded [bytes]; a map with all layers has under 2 MB.
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
            outside its range in `transport.messages.typestore`.
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
        MessageError: the time is negative, or later than 2038-01-19, the end of the type's range.
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


def to_ros(type_name: str, value: Any, **given: Any) -> Any:
    """Make a ROS 2 message object from a dataclass.

    Args:
        type_name: for example `guara_msgs/msg/Refusal`.
        value: object with the fields of the type as attributes, except those in `MADE`.
        given: values of fields that are not converted from `value`.

    Raises:
        MessageError: a field does not fit its ROS 2 type.
    """
    for name, (kind, details) in _definition(type_name).items():
        if name not in given:
            given[name] = MADE[name](value) if name in MADE else _made(getattr(value, name), kind, details)
    return message_class(type_name)(**given)


def from_ros(cls: type[T], message: Any, **given: Any) -> T:
    """Make a dataclass from a ROS 2 message object.

    Args:
        cls: the dataclass.
        message: the message object.
        given: values of attributes that are not converted from `message`.

    Raises:
        MessageError: a value is not allowed.
    """
    definition = _definition(message.__msgtype__)
    try:
        for entry in dataclasses.fields(cls):  # type: ignore[arg-type]
            name = entry.name
            if name in given or not entry.init:
                continue
            if name in READ:
                given[name] = READ[name](message)
            elif name in definition:
                given[name] = _read(getattr(message, name), *definition[name])
        return cls(**given)
    except MessageError:
        raise
    except (TransportError, ValueError, OverflowError) as error:
        raise MessageError(f"{message.__msgtype__.rpartition('/')[2]} refused: {error}") from error


@cache
def _definition(type_name: str) -> dict[str, tuple[int, Any]]:
    message_class(type_name)
    return dict(typestore().get_msgdef(type_name).fields)


def _made(value: Any, kind: int, details: Any) -> Any:
    if kind in ARRAYS:
        inner, inner_details = details[0]
        is_array = isinstance(value, np.ndarray)
        return value if is_array else [_made(entry, inner, inner_details) for entry in value]
    if kind == SUBMESSAGE:
        return SUBMESSAGES[details][0](value) if details in SUBMESSAGES else to_ros(details, value)
    return PLAIN[details[0]](value) if details[0] in PLAIN else int(value)


def _read(value: Any, kind: int, details: Any) -> Any:
    if kind in ARRAYS:
        return value if isinstance(value, np.ndarray) else tuple(_read(entry, *details[0]) for entry in value)
    if kind == SUBMESSAGE:
        return SUBMESSAGES[details][1](value) if details in SUBMESSAGES else from_ros(CLASSES[details], value)
    return bool(value) if details[0] == "bool" else value


def make_point(x: float, y: float, z: float) -> Any:
    """Make a geometry_msgs/Point."""
    return message_class("geometry_msgs/msg/Point")(float(x), float(y), float(z))


def make_stance(stance: StanceMessage) -> Any:
    """Make a guara_msgs/Stance."""
    gravity = stance.gravity_in_base
    vector = message_class("geometry_msgs/msg/Vector3")(*(gravity or (0.0, 0.0, 0.0)))
    positions = np.array(list(stance.joint_positions.values()), dtype=np.float64)
    return message_class("guara_msgs/msg/Stance")(
        list(stance.joint_positions), positions, list(stance.support_feet), gravity is not None, vector
    )


def read_stance(message: Any) -> StanceMessage:
    """Read a guara_msgs/Stance.

    Raises:
        MessageError: names and positions differ in number, a name occurs twice, or a number is not finite.
    """
    names, positions = message.joint_names, message.joint_positions.tolist()
    if len(names) != len(positions):
        raise MessageError(f"stance has {len(names)} joint names but {len(positions)} positions")
    if len(set(names)) != len(names):
        raise MessageError(f"stance names a joint twice: {', '.join(names)}")
    vector = message.gravity_in_base
    gravity: Point | None = (vector.x, vector.y, vector.z) if message.gravity_known else None
    return StanceMessage(
        joint_positions=dict(zip(names, positions, strict=True)),
        support_feet=tuple(message.support_feet),
        gravity_in_base=gravity,
    )


def make_transform(transform: TransformMessage) -> Any:
    """Make a guara_msgs/FrameTransform."""
    x, y, z, w = quaternion_from_matrix(transform.matrix[:3, :3])
    translation = message_class("geometry_msgs/msg/Vector3")(*transform.matrix[:3, 3].tolist())
    rotation = message_class("geometry_msgs/msg/Quaternion")(x, y, z, w)
    covariance = np.zeros(0) if transform.covariance is None else transform.covariance.ravel()
    return message_class("guara_msgs/msg/FrameTransform")(
        transform.source_frame,
        transform.destination_frame,
        message_class("geometry_msgs/msg/Transform")(translation, rotation),
        covariance,
    )


def read_transform(message: Any) -> TransformMessage:
    """Read a guara_msgs/FrameTransform.

    Raises:
        MessageError: the quaternion is not of length 1, the covariance has a length other than 0 or 36, or a number is
            not finite.
    """
    name = f"transform_{message.source_frame}_to_{message.destination_frame}"
    rotation, translation = message.transform.rotation, message.transform.translation
    matrix = np.eye(4)
    matrix[:3, :3] = matrix_from_quaternion((rotation.x, rotation.y, rotation.z, rotation.w), name)
    matrix[:3, 3] = translation.x, translation.y, translation.z
    if len(message.covariance) not in (0, 36):
        raise MessageError(f"covariance of {name} has {len(message.covariance)} numbers; allowed: 0 or 36")
    return TransformMessage(
        source_frame=message.source_frame,
        destination_frame=message.destination_frame,
        matrix=matrix,
        covariance=message.covariance.reshape(6, 6) if len(message.covariance) else None,
    )


PLAIN: Mapping[str, Callable[[Any], Any]] = {"string": str, "bool": bool, "float64": float, "float32": float}
# Functions that make and read the submessages whose Python form is not a dataclass with the same fields.
SUBMESSAGES: Mapping[str, tuple[Callable[[Any], Any], Callable[[Any], Any]]] = {
    TIME: (make_time, read_time),
    "geometry_msgs/msg/Point": (lambda point: make_point(*point), lambda point: (point.x, point.y, point.z)),
    "guara_msgs/msg/Stance": (make_stance, read_stance),
    "guara_msgs/msg/FrameTransform": (make_transform, read_transform),
}
CLASSES: Mapping[str, Any] = {"guara_msgs/msg/Obstacle": ObstacleMessage, "guara_msgs/msg/GroundPatch": GroundPatch}
# Message fields whose Python attribute has another name or form, as functions of the dataclass.
MADE: Mapping[str, Callable[[Any], Any]] = {
    "header": lambda value: make_header(value.stamp, value.frame_id),
    "version_major": lambda value: value.version[0],
    "version_minor": lambda value: value.version[1],
    "origin_x": lambda value: value.origin[0],
    "origin_y": lambda value: value.origin[1],
    "nx": lambda value: value.shape[1],
    "ny": lambda value: value.shape[0],
    "outline": lambda value: [make_point(x, y, 0.0) for x, y in value.outline.tolist()],
    "scan_end_clock": lambda value: math.nan if value.scan_end_clock is None else value.scan_end_clock,
}
# Attributes whose message field has another name or form, as functions of the message.
READ: Mapping[str, Callable[[Any], Any]] = {
    "stamp": lambda message: read_time(message.header.stamp if hasattr(message, "header") else message.stamp),
    "frame_id": lambda message: message.header.frame_id,
    "version": lambda message: (message.version_major, message.version_minor),
    "origin": lambda message: (message.origin_x, message.origin_y),
    "outline": lambda message: np.array([(p.x, p.y) for p in message.outline], np.float64).reshape(-1, 2),
    "scan_end_clock": lambda message: None if math.isnan(message.scan_end_clock) else message.scan_end_clock,
}
