"""Allowed range of every field of every message: one table, applied to each message that is decoded."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from transport.arrays import Array
from transport.exceptions import MessageError
from transport.messages.typestore import (
    QUERY_REQUEST,
    REFUSAL,
    REGIONS,
    SCAN_REPLY,
    SCAN_REQUEST,
    STANCE_PAUSE,
    STATUS,
    SUMMARY,
    TERRAIN,
    message_class,
    typestore,
)

GROUND_PATCH = "guara_msgs/msg/GroundPatch"
# [m] From the origin of any frame; float64 resolves 0.1 nm there.
FURTHEST = 1e6
# [s] No pause is announced, and no scan waited for, longer than an hour.
LONGEST_TIME = 3600.0
# Numbers up to here are exact as float64.
LARGEST_COUNT = 2**53


@dataclass(frozen=True, slots=True, kw_only=True)
class Range:
    """Allowed values of one field; of a list, the values in it.

    Attributes:
        low, high: limits of a number, both allowed; NaN never is unless `nan` says so.
        unit: unit of the number.
        nan: whether NaN is allowed too.
        entries: longest list.
        characters: longest text.
        names: field of the same message that names the entries of a list, for refusals.
    """

    low: float = -math.inf
    high: float = math.inf
    unit: str = ""
    nan: bool = False
    entries: int | None = None
    characters: int | None = None
    names: str = ""

    def cut(self, text: str) -> str:
        """The text, no longer than allowed."""
        return text[: self.characters]

    def __str__(self) -> str:
        """As documents and refusals say it."""
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


def _text(characters: int) -> Range:
    return Range(characters=characters)


def _list(entries: int) -> Range:
    return Range(entries=entries)


def _whole(bits: int) -> Range:
    return Range(low=0, high=2**bits - 1)


NAME, WORD, SENTENCE = _text(100), _text(200), _text(10_000)
METRES = Range(low=-FURTHEST, high=FURTHEST, unit="m")
LENGTH = Range(low=0, high=FURTHEST, unit="m")
COUNT = Range(low=-LARGEST_COUNT, high=LARGEST_COUNT)
SECONDS = Range(low=0, high=LONGEST_TIME, unit="s")
UNBOUNDED_SECONDS = Range(low=0, high=math.inf, unit="s")
# Largest grid, cells; a list of what lies in it.
CELLS, PARTS = _list(4_000_000), _list(100_000)
# Bytes that are unpacked with a limit of their own.
PACKED = _list(64 * 1024 * 1024)
EDGE = Range(low=1e-4, high=10, unit="m")

_MAP_ORIGIN = {
    "version_major": _whole(16),
    "version_minor": _whole(16),
    "robot": NAME,
    "run": NAME,
    "epoch": NAME,
    "sequence": _whole(64),
    "step": COUNT,
    "scan_end_clock": Range(low=0, high=1e10, unit="s", nan=True),
    "valid_for": UNBOUNDED_SECONDS,
    "valid_pauses": _whole(32),
}
_POINT = {"x": METRES, "y": METRES, "z": METRES}
_ONE = Range(low=-1.000001, high=1.000001)

# Every field of every type that this package decodes; flags (bool) and single submessages have no range of their own.
RANGES: Mapping[str, Mapping[str, Range]] = {
    STANCE_PAUSE: {
        "robot": NAME,
        "step": COUNT,
        # A phase of a later version is refused in other words, and changes nothing.
        "phase": _whole(8),
        "time_available": SECONDS,
        "known_ground": _list(64),
        "epoch": NAME,
    },
    GROUND_PATCH: {
        "outline": _list(64),
        "height": METRES,
        "sigma": LENGTH,
    },
    "guara_msgs/msg/Stance": {
        "joint_names": Range(entries=256, characters=200),
        "joint_positions": Range(entries=256, low=-1e6, high=1e6, unit="rad", names="joint_names"),
        "support_feet": Range(entries=64, characters=200),
    },
    TERRAIN: {
        **{name: _MAP_ORIGIN[name] for name in _MAP_ORIGIN if name not in ("run", "epoch", "scan_end_clock")},
        "extent": NAME,
        "mode": NAME,
        "method": NAME,
        "calibration_hash": WORD,
        "resolution": EDGE,
        "origin_x": METRES,
        "origin_y": METRES,
        "nx": Range(low=1, high=4_000_000),
        "ny": Range(low=1, high=4_000_000),
        "layers": _list(64),
        "attitude_source": NAME,
        "transforms": _list(64),
        "obstacles": PARTS,
        "point_count_names": Range(entries=256, characters=200),
        "point_count_values": Range(entries=256, low=0, high=2**64 - 1),
        "stage_names": Range(entries=256, characters=200),
        "stage_ms": Range(entries=256, low=0, high=1e9, unit="ms"),
        "coverage": Range(low=0, high=1),
        "health": Range(low=0, high=3),
        "health_reasons": Range(entries=1000, characters=10_000),
        "metadata": _text(4_000_000),
    },
    "guara_msgs/msg/TerrainLayer": {
        "name": WORD,
        "unit": NAME,
        "type": _whole(8),
        "float32_values": Range(entries=4_000_000, low=-FURTHEST, high=FURTHEST, nan=True),
        "uint16_values": CELLS,
        "uint8_values": CELLS,
    },
    "guara_msgs/msg/FrameTransform": {
        "source_frame": WORD,
        "destination_frame": WORD,
        "covariance": Range(entries=36, low=-1e12, high=1e12),
    },
    "guara_msgs/msg/Obstacle": {
        "outline": PARTS,
        "height": METRES,
        "sigma": LENGTH,
        "hazard": _whole(16),
    },
    SUMMARY: {
        **_MAP_ORIGIN,
        "resolution": EDGE,
        "origin_x": METRES,
        "origin_y": METRES,
        "nx": Range(low=1, high=4_000_000),
        "ny": Range(low=1, high=4_000_000),
        "heights": PACKED,
        "hazard": PACKED,
        "traversability": PACKED,
    },
    REGIONS: {**_MAP_ORIGIN, "regions": _list(1000)},
    "guara_msgs/msg/SteppableRegion": {
        "boundary": _list(256),
        "halfspaces": Range(entries=3 * 256, low=-FURTHEST, high=FURTHEST, unit="m"),
        "sigma": LENGTH,
        "area": Range(low=0, high=FURTHEST**2, unit="m^2"),
    },
    SCAN_REQUEST: {"id": WORD, "mode": NAME, "timeout": SECONDS},
    SCAN_REPLY: {
        "id": WORD,
        "state": Range(low=1, high=4),
        "stripes_done": _whole(32),
        "stripes_total": _whole(32),
        "step": COUNT,
        "sequence": _whole(64),
        "code": NAME,
        "message": SENTENCE,
    },
    REFUSAL: {"id": WORD, "code": NAME, "message": SENTENCE},
    QUERY_REQUEST: {"extent": NAME, "x_min": METRES, "x_max": METRES, "y_min": METRES, "y_max": METRES},
    "guara_msgs/msg/ScanStart": {"robot": NAME, "mode": NAME, "step": COUNT, "calibration_hash": WORD},
    "guara_msgs/msg/Stripe": {
        "step": COUNT,
        "index": _whole(16),
        "mirror_angle": Range(low=-1e3, high=1e3, unit="rad"),
        "on_topic": WORD,
        "off_topic": WORD,
    },
    "guara_msgs/msg/ScanEnd": {"step": COUNT, "stripes": _whole(32)},
    STATUS: {"status": _list(1000)},
    "diagnostic_msgs/msg/DiagnosticStatus": {
        "level": Range(low=0, high=3),
        "name": WORD,
        "message": SENTENCE,
        "hardware_id": WORD,
        "values": _list(1000),
    },
    "diagnostic_msgs/msg/KeyValue": {"key": WORD, "value": SENTENCE},
    "std_msgs/msg/Header": {"frame_id": WORD},
    "builtin_interfaces/msg/Time": {
        "sec": Range(low=0, high=2**31 - 1, unit="s"),
        "nanosec": Range(low=0, high=999_999_999, unit="ns"),
    },
    "geometry_msgs/msg/Point": _POINT,
    "geometry_msgs/msg/Vector3": _POINT | {axis: Range(low=-FURTHEST, high=FURTHEST) for axis in "xyz"},
    "geometry_msgs/msg/Quaternion": dict.fromkeys("xyzw", _ONE),
    # Nothing but submessages.
    "geometry_msgs/msg/Transform": {},
    "geometry_msgs/msg/Pose": {},
}
# Length of a vector that points along gravity: in g, m/s^2, or counts of a sensor.
GRAVITY_LENGTH = Range(low=1e-3, high=1e6)

Check = Callable[[Any], None]


def check_ranges(message: Any) -> None:
    """Check every field of a message object, and of those in it; types outside of `RANGES` pass.

    Raises:
        MessageError: a field is out of its range; the text names field, value and range.
    """
    if message.__msgtype__ in RANGES:
        for check in _checks(message.__msgtype__):
            check(message)


def check_value(type_name: str, field: str, value: Any) -> None:
    """Check the value of one field of a type; raises as `check_ranges` does."""
    _check(f"{field} of {type_name.rpartition('/')[2]}", RANGES[type_name][field], value)


def check_gravity(vector: tuple[float, float, float]) -> None:
    """Check the length of a vector that points along gravity; raises as `check_ranges` does."""
    _check("length of gravity_in_base", GRAVITY_LENGTH, math.hypot(*vector))


@cache
def _checks(type_name: str) -> tuple[Check, ...]:
    """Checks of the fields of one type, in the order of its definition."""
    made = []
    for field, (kind, details) in typestore().get_msgdef(type_name).fields:
        allowed = RANGES[type_name].get(field)
        if allowed is not None:
            made.append(_field_check(f"{field} of {type_name.rpartition('/')[2]}", field, allowed))
        inner = details if kind == 2 else details[0][1] if kind in (3, 4) and details[0][0] == 2 else None
        if inner is not None:
            made.append(_submessages_check(field, is_list=kind != 2))
    return tuple(made)


def _field_check(what: str, field: str, allowed: Range) -> Check:
    def check(message: Any) -> None:
        _check(what, allowed, getattr(message, field), getattr(message, allowed.names) if allowed.names else ())

    return check


def _submessages_check(field: str, *, is_list: bool) -> Check:
    def check(message: Any) -> None:
        for inner in getattr(message, field) if is_list else (getattr(message, field),):
            check_ranges(inner)

    return check


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
        raise MessageError(f"{what} is {value:.6g}; allowed: {allowed}")


def range_rows() -> list[str]:
    """Rows of the table of ranges in the documentation, a type each."""
    rows = []
    for type_name, fields in RANGES.items():
        message_class(type_name)
        parts: dict[str, list[str]] = {}
        for field, allowed in fields.items():
            if str(allowed):
                parts.setdefault(str(allowed), []).append(f"`{field}`")
        text = "; ".join(f"{', '.join(names)}: {allowed}" for allowed, names in parts.items())
        if text:
            rows.append(f"| `{type_name.replace('guara_msgs/msg/', '')}` | {text} |")
    return rows
