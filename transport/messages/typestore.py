"""Message types of ROS 2, guara_msgs and grid_map_msgs: classes, Zenoh encodings, and allowed values of fields."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING, Any

import numpy as np

from transport.arrays import Array
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

# Codes of field types in a message definition of rosbags.
SUBMESSAGE, ARRAYS = 2, (3, 4)
# Default values of the types that are not integers.
ZEROS = {"string": "", "bool": False, "float32": 0.0, "float64": 0.0}
GROUND_PATCH = "guara_msgs/msg/GroundPatch"
# Largest magnitude of a coordinate in any frame [m]; float64 resolves 0.1 nm there.
FURTHEST = 1e6
# Longest announced pause and longest timeout of a scan [s].
LONGEST_TIME = 3600.0
# All integers up to this one are exact in float64.
LARGEST_COUNT = 2**53


def message_files() -> dict[str, str]:
    """Return the texts of the `.msg` files of guara_msgs and grid_map_msgs, by type name."""
    folder = files("transport") / "msg"
    found: dict[str, str] = {}
    for package, path in (("guara_msgs", folder), ("grid_map_msgs", folder / "grid_map_msgs")):
        for entry in path.iterdir():
            if entry.name.endswith(".msg"):
                found[f"{package}/msg/{entry.name.removesuffix('.msg')}"] = entry.read_text(encoding="utf-8")
    return dict(sorted(found.items()))


@cache
def typestore() -> Typestore:
    """Return the rosbags type store of ROS 2 Jazzy, guara_msgs and grid_map_msgs; loaded at the first call."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    types: dict[str, Any] = {}
    for name, text in message_files().items():
        types.update(get_types_from_msg(text, name))
    store.register(types)
    return store


@cache
def warm_up() -> None:
    """Load the definitions of common messages; otherwise the first message is delayed by a tenth of a second."""
    for name in (TERRAIN, STANCE_PAUSE, SCAN_REQUEST, SCAN_REPLY, QUERY_REQUEST, OCCUPANCY, GRID_MAP, STATUS):
        typestore().get_msgdef(name)


def message_class(type_name: str) -> Any:
    """Return the class of the message objects of a type; its fields are in the order of the definition.

    Raises:
        MessageError: the type is not known.
    """
    known = typestore().types
    if type_name not in known:
        own_types = ", ".join(message_files())
        raise MessageError(
            f"message type {type_name!r} is not known; known types: those of ROS 2 Jazzy, and {own_types}"
        )
    return known[type_name]


def make_message(type_name: str, **given: Any) -> Any:
    """Make a message object. Fields that are not given are zero or empty; a quaternion without `w` has w = 1.

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
    """Return the definition of a type and of all types that it uses, in the form of `ros2msg` schemas in MCAP."""
    message_class(type_name)
    text, _ = typestore().generate_msgdef(type_name, ros_version=2)
    return text


def type_hash(type_name: str) -> str:
    """Return the ROS 2 type hash (`RIHS01_...`) of a type, which is part of rmw_zenoh keys."""
    message_class(type_name)
    return typestore().hash_rihs01(type_name)


def dds_type_name(type_name: str) -> str:
    """Return the DDS name of a type, such as `nav_msgs::msg::dds_::OccupancyGrid_`."""
    message_class(type_name)
    package, kind, name = type_name.split("/")
    return f"{package}::{kind}::dds_::{name}_"


def cdr(type_name: str) -> str:
    """Return the Zenoh encoding of a CDR payload, such as `application/cdr;nav_msgs/msg/OccupancyGrid`.

    The encoding informs other tools of the type. This package does not read it, because earlier versions sent none.
    """
    return f"application/cdr;{type_name}"


def compact(type_name: str) -> str:
    """Return the Zenoh encoding of a CDR payload that is compressed by `transport.messages.shuffle`."""
    return f"application/zstd;shuffle=4;{cdr(type_name)}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Range:
    """Allowed values of a field, or of the elements of a list.

    Attributes:
        low, high: limits of a number, inclusive.
        unit: unit of the number.
        nan: True if NaN is allowed too.
        entries: largest number of elements in a list; None = no limit.
        characters: largest length of a text; None = no limit.
        names: field of the same message with the names of the elements, for error messages; "" = none.
    """

    low: float = -math.inf
    high: float = math.inf
    unit: str = ""
    nan: bool = False
    entries: int | None = None
    characters: int | None = None
    names: str = ""

    def cut(self, text: str) -> str:
        """Truncate a text to `characters`, if there is such a limit."""
        return text[: self.characters]

    def __str__(self) -> str:
        """Describe the range, for documentation and error messages."""
        parts = [] if self.entries is None else [f"up to {self.entries:,} entries"]
        if self.characters is not None:
            parts.append(f"up to {self.characters:,} characters")
        if self.low > -math.inf or self.high < math.inf:
            numbers = f"{_number(self.low)} to {_number(self.high)} {self.unit}".strip()
            parts.append(f"{numbers} or NaN" if self.nan else numbers)
        return ", ".join(parts)


def _number(value: float) -> str:
    if value == LARGEST_COUNT or value == -LARGEST_COUNT:
        return "2^53" if value > 0 else "-2^53"
    if float(value).is_integer() and abs(value) >= 2**31 - 1:
        bits = int(abs(value) + 1).bit_length() - 1
        return f"2^{bits} - 1" if 2**bits - 1 == value else f"{value:g}"
    return f"{value:,.0f}" if math.isfinite(value) and float(value).is_integer() else f"{value:g}"


NAME, WORD, SENTENCE = (Range(characters=most) for most in (100, 200, 10_000))
METRES = Range(low=-FURTHEST, high=FURTHEST, unit="m")
# Limits of the number of cells of a grid (CELLS), and of obstacles of a grid or corners of an obstacle (PARTS).
CELLS, PARTS = Range(entries=4_000_000), Range(entries=100_000)
# Limit of the number of compressed bytes; the decompressed size has a limit of its own.
PACKED = Range(entries=64 * 1024 * 1024)

# Ranges by field name. A field name has the same meaning in every message, except in EXCEPTIONS.
FIELDS: Mapping[str, Range] = {
    **dict.fromkeys(("robot", "run", "epoch", "extent", "mode", "method", "attitude_source", "unit", "code"), NAME),
    **dict.fromkeys(("calibration_hash", "name", "hardware_id", "key", "id", "on_topic", "off_topic"), WORD),
    **dict.fromkeys(("frame_id", "source_frame", "destination_frame"), WORD),
    **dict.fromkeys(("message", "value"), SENTENCE),
    **dict.fromkeys(("x", "y", "z", "origin_x", "origin_y", "height"), METRES),
    **dict.fromkeys(("x_min", "x_max", "y_min", "y_max"), METRES),
    **dict.fromkeys(("uint16_values", "uint8_values"), CELLS),
    **dict.fromkeys(("heights", "hazard", "traversability"), PACKED),
    **dict.fromkeys(("layers", "transforms", "known_ground", "outline"), Range(entries=64)),
    **dict.fromkeys(("status", "values", "regions"), Range(entries=1000)),
    **dict.fromkeys(("joint_names", "point_count_names", "stage_names"), Range(entries=256, characters=200)),
    **dict.fromkeys(("level", "health"), Range(low=0, high=3)),
    **dict.fromkeys(("nx", "ny"), Range(low=1, high=4_000_000)),
    **dict.fromkeys(("time_available", "timeout"), Range(low=0, high=LONGEST_TIME, unit="s")),
    "standing_pauses": Range(entries=64),
    "step": Range(low=-LARGEST_COUNT, high=LARGEST_COUNT),
    "scan_end_clock": Range(low=0, high=1e10, unit="s", nan=True),
    "valid_for": Range(low=0, high=math.inf, unit="s"),
    "resolution": Range(low=1e-4, high=10, unit="m"),
    "sigma": Range(low=0, high=FURTHEST, unit="m"),
    "area": Range(low=0, high=FURTHEST**2, unit="m^2"),
    "joint_positions": Range(entries=256, low=-1e6, high=1e6, unit="rad", names="joint_names"),
    "support_feet": Range(entries=64, characters=200),
    "obstacles": PARTS,
    "point_count_values": Range(entries=256, low=0, high=2**64 - 1),
    "stage_ms": Range(entries=256, low=0, high=1e9, unit="ms"),
    "coverage": Range(low=0, high=1),
    "health_reasons": Range(entries=1000, characters=10_000),
    "metadata": Range(characters=4_000_000),
    "float32_values": Range(entries=4_000_000, low=-FURTHEST, high=FURTHEST, nan=True),
    "covariance": Range(entries=36, low=-1e12, high=1e12),
    "boundary": Range(entries=256),
    "halfspaces": Range(entries=3 * 256, low=-FURTHEST, high=FURTHEST, unit="m"),
    "state": Range(low=1, high=4),
    "mirror_angle": Range(low=-1e3, high=1e3, unit="rad"),
    "sec": Range(low=0, high=2**31 - 1, unit="s"),
    "nanosec": Range(low=0, high=999_999_999, unit="ns"),
}
EXCEPTIONS: Mapping[str, Mapping[str, Range]] = {
    "guara_msgs/msg/Obstacle": {"outline": PARTS, "hazard": Range(low=0, high=2**16 - 1)},
    "geometry_msgs/msg/Vector3": dict.fromkeys("xyz", Range(low=-FURTHEST, high=FURTHEST)),
    QUATERNION: dict.fromkeys("xyzw", Range(low=-1.000001, high=1.000001)),
    # Flattened arrays of up to 1,000 samples, with up to 256 joints, 64 legs or 3 axes each.
    STANCE_STREAM: {
        "joint_positions": Range(entries=256_000, low=-1e6, high=1e6, unit="rad"),
        "legs": Range(entries=64, characters=200),
        "times": Range(entries=1000, low=0, high=10, unit="s"),
        "supports": Range(entries=64_000, low=0, high=1),
        "gravity_in_base": Range(entries=3000, low=-1e6, high=1e6, nan=True),
        "angular_velocity": Range(entries=3000, low=-1e3, high=1e3, unit="rad/s", nan=True),
    },
}
# Types whose messages are checked after decoding, including all submessages.
TYPES: tuple[str, ...] = (STANCE_PAUSE, TERRAIN, SUMMARY, REGIONS, SCAN_REQUEST, SCAN_REPLY, REFUSAL, QUERY_REQUEST)
TYPES += (SCAN_START, STRIPE, SCAN_END, STATUS, TIME, STANCE_STREAM)
# Allowed length of a gravity vector, in any unit: g, m/s^2 or sensor counts.
GRAVITY_LENGTH = Range(low=1e-3, high=1e6)


def check_ranges(message: Any) -> None:
    """Check every field of a message object and its submessages, if its type is one of `TYPES`.

    Raises:
        MessageError: a value is outside its range; the error message contains field, value and range.
    """
    if message.__msgtype__ in TYPES:
        _check_all(message)


def _check_all(message: Any) -> None:
    for field, what, allowed, has_messages in _checked_fields(message.__msgtype__):
        value = getattr(message, field)
        if allowed is not None:
            _check(what, allowed, value, getattr(message, allowed.names) if allowed.names else ())
        if has_messages:
            for inner in value if isinstance(value, list | tuple) else (value,):
                _check_all(inner)


@cache
def ranges(type_name: str) -> Mapping[str, Range]:
    """Return the range of each field that has one; by default, an integer has the range of its type."""
    own, found = EXCEPTIONS.get(type_name, {}), {}
    for name, (kind, details) in typestore().get_msgdef(type_name).fields:
        allowed = own.get(name, FIELDS.get(name))
        if allowed is None and kind not in (SUBMESSAGE, *ARRAYS) and "int" in details[0]:
            limits = np.iinfo(str(details[0]))
            allowed = Range(low=int(limits.min), high=int(limits.max))
        if allowed is not None and kind != SUBMESSAGE:
            found[name] = allowed
    return found


def check_value(type_name: str, field: str, value: Any) -> None:
    """Check the value of one field of a type; errors as in `check_ranges`."""
    _check(f"{field} of {type_name.rpartition('/')[2]}", ranges(type_name)[field], value)


def check_gravity(vector: tuple[float, float, float]) -> None:
    """Check the length of a gravity vector; errors as in `check_ranges`."""
    _check("length of gravity_in_base", GRAVITY_LENGTH, math.hypot(*vector))


@cache
def _checked_fields(type_name: str) -> tuple[tuple[str, str, Range | None, bool], ...]:
    """List the fields of a type that have a range or contain submessages, in the order of the definition.

    Returns:
        For each such field: its name, its description in errors, its range, and True if it contains submessages.
    """
    message, fields = type_name.rpartition("/")[2], typestore().get_msgdef(type_name).fields
    found = ((name, ranges(type_name).get(name), bool(inner_type(*form))) for name, form in fields)
    return tuple((name, f"{name} of {message}", allowed, holds) for name, allowed, holds in found if allowed or holds)


def inner_type(kind: int, details: Any) -> str:
    """Return the type of the submessages in a field, or "" if the field has none."""
    inner, name = details[0] if kind in ARRAYS else (kind, details)
    return name if inner == SUBMESSAGE else ""


def _check(what: str, allowed: Range, value: Any, names: Sequence[str] = ()) -> None:
    if isinstance(value, str):
        if allowed.characters is not None and len(value) > allowed.characters:
            raise MessageError(f"{what} has {len(value)} characters; allowed: {allowed}")
        return
    if isinstance(value, list | tuple | np.ndarray):
        if allowed.entries is not None and len(value) > allowed.entries:
            raise MessageError(f"{what} has {len(value)} entries; allowed: {allowed}")
        if isinstance(value, np.ndarray):
            _check_values(what, allowed, value, names)
        elif allowed.characters is not None:
            for text in value:
                _check(f"an entry of {what}", allowed, text)
        return
    _check_number(what, allowed, value)


def _check_values(what: str, allowed: Range, values: Array, names: Sequence[str]) -> None:
    if not len(values) or (allowed.low == -math.inf and allowed.high == math.inf):
        return
    lowest, highest = (np.fmin, np.fmax) if allowed.nan else (np.minimum, np.maximum)
    for extreme in (lowest.reduce(values), highest.reduce(values)):
        if not allowed.low <= extreme <= allowed.high and not (allowed.nan and extreme != extreme):
            first = int(np.flatnonzero((values == extreme) | (values != values))[0])
            entry = repr(names[first]) if first < len(names) else str(first)
            _check_number(f"entry {entry} of {what}", allowed, extreme)


def _check_number(what: str, allowed: Range, value: float) -> None:
    if not allowed.low <= value <= allowed.high and not (allowed.nan and value != value):
        shown = value if isinstance(value, int) else f"{value:.6g}"
        raise MessageError(f"{what} is {shown}; allowed: {allowed}")
