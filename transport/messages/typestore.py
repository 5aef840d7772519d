"""Message types of ROS 2, guara_msgs and grid_map_msgs, their classes, and the encodings that name them in Zenoh."""

from __future__ import annotations

from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING, Any

import numpy as np

from transport.exceptions import MessageError

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

TERRAIN = "guara_msgs/msg/Terrain"
SUMMARY = "guara_msgs/msg/TerrainSummary"
REGIONS = "guara_msgs/msg/SteppableRegions"
STANCE_PAUSE = "guara_msgs/msg/StancePause"
STANCE_STREAM = "guara_msgs/msg/StanceStream"
SCAN_REQUEST = "guara_msgs/msg/ScanRequest"
SCAN_REPLY = "guara_msgs/msg/ScanReply"
REFUSAL = "guara_msgs/msg/Refusal"
QUERY_REQUEST = "guara_msgs/msg/QueryRequest"
OCCUPANCY = "nav_msgs/msg/OccupancyGrid"
GRID_MAP = "grid_map_msgs/msg/GridMap"
STATUS = "diagnostic_msgs/msg/DiagnosticArray"
IMAGE = "sensor_msgs/msg/Image"
COMPRESSED_IMAGE = "sensor_msgs/msg/CompressedImage"
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
POINT_CLOUD = "sensor_msgs/msg/PointCloud2"
FRAMES = "tf2_msgs/msg/TFMessage"
SCAN_START = "guara_msgs/msg/ScanStart"
STRIPE = "guara_msgs/msg/Stripe"
SCAN_END = "guara_msgs/msg/ScanEnd"
TEXT = "std_msgs/msg/String"
TIME = "builtin_interfaces/msg/Time"
MARKERS = "visualization_msgs/msg/MarkerArray"
QUATERNION = "geometry_msgs/msg/Quaternion"

# Kinds of fields in a definition of rosbags.
SUBMESSAGE, ARRAYS = 2, (3, 4)
# Default values of the types that are not integers.
ZEROS = {"string": "", "bool": False, "float32": 0.0, "float64": 0.0}


def message_files() -> dict[str, str]:
    """Texts of the `.msg` files of this package, by type name such as `guara_msgs/msg/Terrain`."""
    folder = files("transport") / "msg"
    found: dict[str, str] = {}
    for package, path in (("guara_msgs", folder), ("grid_map_msgs", folder / "grid_map_msgs")):
        for entry in path.iterdir():
            if entry.name.endswith(".msg"):
                found[f"{package}/msg/{entry.name.removesuffix('.msg')}"] = entry.read_text(encoding="utf-8")
    return dict(sorted(found.items()))


@cache
def typestore() -> Typestore:
    """Type store of rosbags with all types of this package, loaded at the first call."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    types: dict[str, Any] = {}
    for name, text in message_files().items():
        types.update(get_types_from_msg(text, name))
    store.register(types)
    return store


@cache
def warm_up() -> None:
    """Load the definitions of common messages, which would otherwise delay the first one by a tenth of a second."""
    for name in (TERRAIN, STANCE_PAUSE, SCAN_REQUEST, SCAN_REPLY, QUERY_REQUEST, OCCUPANCY, GRID_MAP, STATUS):
        typestore().get_msgdef(name)


def message_class(type_name: str) -> Any:
    """Class of the message objects of a type; its fields are in the order of the definition.

    Raises:
        MessageError: the type is not known.
    """
    known = typestore().types
    if type_name not in known:
        own_types = ", ".join(message_files())
        raise MessageError(
            f"message type {type_name!r} is not known; known are the types of ROS 2 Jazzy and {own_types}"
        )
    return known[type_name]


def make_message(type_name: str, **given: Any) -> Any:
    """Make a message object; fields that are not given are zero or empty, quaternions the identity.

    Raises:
        MessageError: the type is not known.
    """
    cls = message_class(type_name)
    if type_name == QUATERNION:
        given.setdefault("w", 1.0)
    fields = typestore().get_msgdef(type_name).fields
    return cls(**{name: given[name] if name in given else _zero(*form) for name, form in fields})


def _zero(kind: int, details: Any) -> Any:
    if kind == SUBMESSAGE:
        return make_message(details)
    if kind in ARRAYS:
        (inner, base), length = details
        return [] if inner == SUBMESSAGE or base[0] == "string" else np.zeros(length, base[0])
    return ZEROS.get(details[0], 0)


def message_definition(type_name: str) -> str:
    """Definition of a type with all types that it uses, in the form of `ros2msg` schemas in MCAP."""
    message_class(type_name)
    text, _ = typestore().generate_msgdef(type_name, ros_version=2)
    return text


def type_hash(type_name: str) -> str:
    """ROS 2 type hash (`RIHS01_...`) of a type, part of the keys of rmw_zenoh."""
    message_class(type_name)
    return typestore().hash_rihs01(type_name)


def dds_type_name(type_name: str) -> str:
    """Name of a type in DDS style, such as `nav_msgs::msg::dds_::OccupancyGrid_`."""
    message_class(type_name)
    package, kind, name = type_name.split("/")
    return f"{package}::{kind}::dds_::{name}_"


def cdr(type_name: str) -> str:
    """Zenoh encoding of a CDR payload: `application/cdr;nav_msgs/msg/OccupancyGrid`.

    It tells other tools the type. Receivers of this package do not read it: earlier versions sent none.
    """
    return f"application/cdr;{type_name}"


def compact(type_name: str) -> str:
    """Zenoh encoding of a CDR payload that was compressed (`transport.messages.shuffle`)."""
    return f"application/zstd;shuffle=4;{cdr(type_name)}"
