"""Status of the node, and its CDR payload as diagnostic_msgs/DiagnosticArray."""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from types import MappingProxyType

from transport.messages.codec import decode, encode, from_ros, make_header, to_ros
from transport.messages.terrain_message import Health
from transport.messages.typestore import SENTENCE, STATUS, WORD, message_class

# Name of the item about the transport itself; its values include `step`, the number of the stance pause.
STATUS_NAME = "transport"
ITEM = "diagnostic_msgs/msg/DiagnosticStatus"


@dataclass(frozen=True, slots=True, kw_only=True)
class StatusItem:
    """Status of one part of the node.

    Attributes:
        name: name of the part, for example "scanner".
        level: OK, WARN, ERROR or STALE.
        message: one line of text.
        hardware_id: name of the device or robot; may be empty.
        values: values as text, by name.
    """

    name: str
    level: Health
    message: str = ""
    hardware_id: str = ""
    values: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Convert the values to a read-only mapping of strings, and truncate strings that exceed their limits."""
        for name, allowed in (("name", WORD), ("message", SENTENCE), ("hardware_id", WORD)):
            object.__setattr__(self, name, allowed.cut(getattr(self, name)))
        values = {WORD.cut(str(key)): SENTENCE.cut(str(value)) for key, value in self.values.items()}
        object.__setattr__(self, "values", MappingProxyType(values))


@dataclass(frozen=True, slots=True, kw_only=True)
class Status:
    """Status of the node, with one item for each part of the node.

    Attributes:
        stamp: time of the status [ns since the Unix epoch].
        items: status of each part.
    """

    stamp: int
    items: tuple[StatusItem, ...]

    @property
    def level(self) -> Health:
        """Worst level of all items; STALE if there are none."""
        return max((item.level for item in self.items), default=Health.STALE)

    def item(self, name: str) -> StatusItem | None:
        """Return the item of one part, or None."""
        return next((item for item in self.items if item.name == name), None)


def whole_number(text: str) -> int | None:
    """Convert a value of a status to an integer; None if it is not an integer."""
    with suppress(ValueError):
        return int(text)
    return None


def number(text: str) -> float:
    """Convert a value of a status to a float; NaN if it is not a number."""
    with suppress(ValueError):
        return float(text)
    return math.nan


def encode_status(status: Status) -> bytearray:
    """Encode a status as CDR of diagnostic_msgs/DiagnosticArray.

    Raises:
        MessageError: a field does not fit its ROS 2 type.
    """
    pair = message_class("diagnostic_msgs/msg/KeyValue")
    items = [to_ros(ITEM, item, values=[pair(*figure) for figure in item.values.items()]) for item in status.items]
    return encode(message_class(STATUS)(make_header(status.stamp, ""), items))


def decode_status(payload: bytes | bytearray | memoryview) -> Status:
    """Decode and check the CDR payload of a status.

    Raises:
        MessageError: the payload is damaged, or a value is outside its range.
    """
    message = decode(payload, STATUS)
    items = [
        from_ros(StatusItem, item, level=Health(item.level), values={pair.key: pair.value for pair in item.values})
        for item in message.status
    ]
    return from_ros(Status, message, items=tuple(items))
