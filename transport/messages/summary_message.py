"""Summary of a fused map in three quantised layers: message in Python, and its CDR payload."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from transport.arrays import Array
from transport.exceptions import MessageError
from transport.messages.codec import decode, encode
from transport.messages.map_origin import MapOrigin, check_version
from transport.messages.ranges import check_value
from transport.messages.shuffle import compress, decompress
from transport.messages.submessage_codec import from_ros, to_ros
from transport.messages.submessages import checked_origin, checked_shape, finite, frozen, set_fields
from transport.messages.typestore import SUMMARY

# Stands in `heights` [mm] where the height is not known.
UNKNOWN_HEIGHT = -32768
# Dtype of each layer on the wire, little endian.
LAYERS: Mapping[str, np.dtype[Any]] = {
    "heights": np.dtype("<i2"),
    "hazard": np.dtype("<u2"),
    "traversability": np.dtype("u1"),
}


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SummaryMessage(MapOrigin):
    """Fused map in compact form: heights, flags and traversability of every cell.

    Attributes:
        resolution: [m] edge of a cell.
        origin: [m] (x, y) of the corner of cell (0, 0) in `frame_id`.
        heights: (ny, nx) int16 [mm], `UNKNOWN_HEIGHT` where not known.
        hazard: (ny, nx) uint16 flags.
        traversability: (ny, nx) uint8 [1/255], 0 never.
    """

    # `GridJudge` judges it as a grid of this kind, not as the map itself.
    extent: ClassVar[str] = "summary"
    type_name: ClassVar[str] = SUMMARY

    resolution: float
    origin: tuple[float, float]
    heights: Array
    hazard: Array
    traversability: Array

    def __post_init__(self) -> None:
        """Check what others rely on, and make the arrays read-only."""
        # Without arguments `super` would look in the class that `slots` replaced.
        super(SummaryMessage, self).__post_init__()
        shape = checked_shape(self.heights.shape, "summary")
        for name, dtype in LAYERS.items():
            array = getattr(self, name)
            if array.shape != shape or array.dtype != dtype:
                raise MessageError(
                    f"layer {name!r} of a summary is {array.dtype} {array.shape}; allowed: {dtype} {shape}"
                )
            set_fields(self, **{name: frozen(array)})
        if self.withdrawn and ((self.heights != UNKNOWN_HEIGHT).any() or self.traversability.any()):
            raise MessageError("withdrawn, and yet cells of the summary are known; allowed: none")
        checked_origin(self.origin)
        check_value(SUMMARY, "resolution", finite(self.resolution, "resolution"))

    @property
    def shape(self) -> tuple[int, int]:
        """(ny, nx)."""
        ny, nx = self.heights.shape
        return ny, nx


def encode_summary(summary: SummaryMessage) -> bytearray:
    """The CDR payload of a summary, a guara_msgs/TerrainSummary.

    Raises:
        MessageError: a field does not fit its ROS 2 type.
    """
    packed = {
        name: np.frombuffer(compress(getattr(summary, name).tobytes(), dtype.itemsize), np.uint8)
        for name, dtype in LAYERS.items()
    }
    return encode(to_ros(SUMMARY, summary, **packed))


def decode_summary(payload: bytes | bytearray | memoryview) -> SummaryMessage:
    """A summary from its CDR payload.

    Raises:
        VersionError: another major version.
        MessageError: the payload is damaged, or a length or number is not what the message allows.
    """
    message = decode(payload, SUMMARY)
    check_version(message, "summary")
    shape = checked_shape((message.ny, message.nx), "summary")
    layers: dict[str, Any] = {
        name: _unpack(getattr(message, name), name, dtype, shape) for name, dtype in LAYERS.items()
    }
    return from_ros(SummaryMessage, message, **layers)


def _unpack(packed: Array, name: str, dtype: np.dtype[Any], shape: tuple[int, int]) -> Array:
    size = shape[0] * shape[1] * dtype.itemsize
    plain = decompress(packed.tobytes(), dtype.itemsize, maximum=size)
    if len(plain) != size:
        raise MessageError(f"layer {name!r} of a summary has {len(plain)} bytes; {size} are ny * nx values")
    return np.frombuffer(plain, dtype).reshape(shape)
